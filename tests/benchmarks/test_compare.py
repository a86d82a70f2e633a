"""The comparison of devices: what is planned, checked, timed and skipped, and how records become a page."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import _machine, compare, report
from benchmarks._garments import garment_of, mesh_of_size, subdivide
from benchmarks._machine import Ceilings, counting_compilations, integrate_power, measure_ceilings
from benchmarks._networks import layer_shapes
from benchmarks._pieces import measured, too_large, too_long
from benchmarks._platforms import aims_table
from benchmarks._reference import ReferenceGraph, double
from benchmarks._subjects import Cell, work_of_layers
from benchmarks.compare import ALL, NETWORKS, Config, main, measure_cell, plan, summary, time_calls
from tryon_jax.graph import build_graph
from tryon_jax.graph.smoothing import make_smoother
from tryon_jax.nets.config import load_config, paper_form
from tryon_jax.nets.unet import UNetConfig, init_unet
from tryon_jax.tryon import Garment, Stage, apply_stage, drape, init_model, smooth_features

FAST = Ceilings({"float32": 1e3, "bfloat16": 1e3}, 1e2)


def test_the_plan_covers_every_subject_and_sweep():
    cells = plan(Config())
    assert len(set(cells)) == len(cells)
    assert {cell.subject for cell in cells} == set(ALL)
    for subject in NETWORKS:
        for config in ("small", "paper"):
            mine = [c for c in cells if (c.subject, c.config, c.precision) == (subject, config, "float32")]
            assert {c.batch for c in mine if c.vertices == 3581} == {1, 8, 64, 256}
            assert {c.vertices for c in mine if c.batch == 8} == {1414, 3581, 14_000, 100_000}
    assert {c.precision for c in cells if c.subject == "drape"} == {"float32", "tf32", "bfloat16"}
    # Time that runs out costs the ends of the sweeps: every subject's middle comes first.
    middles = {(c.subject, c.config) for c in cells[: len({(c.subject, c.config) for c in cells}) + 10]}
    assert {subject for subject, _ in middles} == set(ALL)
    assert set(cells) <= set(plan(Config(full=True)))
    assert len(plan(Config(quick=True))) < 0.5 * len(cells)
    with pytest.raises(ValueError, match="unknown subject 'drap'"):
        plan(Config(subjects=("drap",)))


def test_what_is_too_large_is_skipped_and_says_why():
    slow = Ceilings({"float32": 1e-3}, 1e-3)
    config = Config(max_call_seconds=0.1, peers=False)
    cell = Cell("Laplacian product", "small", 300, 8)
    assert "one call would take about" in measure_cell(cell, config, slow)["skipped"]
    assert "GB" in measure_cell(cell, Config(max_gigabytes=1e-6), FAST)["skipped"]
    tf32 = Cell("drape", "small", 300, 8, "tf32")
    assert measure_cell(tf32, config, FAST)["skipped"] == "the device has no tf32"


@pytest.mark.parametrize("subject", ["Laplacian product", "Chebyshev layer"])
def test_a_cell_is_compiled_checked_and_timed(subject):
    entry = measure_cell(Cell(subject, "small", 300, 2), Config(repeats=3), FAST)
    assert entry["error"] < 1e-4
    assert entry["compilations"] >= 1
    assert entry["compilations_afterwards"] == 0
    assert len(entry["runs_ms"]) == 3
    assert entry["lower_ms"] <= entry["ms"] <= entry["upper_ms"]
    assert entry["per_second"] == pytest.approx(2e3 / entry["ms"])
    assert any(name.startswith("SciPy") for name in entry["beside"])


def test_a_wrong_result_is_never_timed(monkeypatch):
    from benchmarks import _subjects

    monkeypatch.setattr(_subjects, "apply_operator", lambda _, x: 1.01 * x)
    with pytest.raises(ValueError, match=r"is wrong: .* from float64"):
        measure_cell(Cell("Laplacian product", "small", 300, 2), Config(peers=False), FAST)


@pytest.mark.slow
@pytest.mark.parametrize(
    "subject", ["U-Net gradient", "drape", "training step", "collision loss", "solver step", "drape with fields"]
)
def test_the_larger_subjects_agree_with_float64(subject):
    config = "small" if subject in NETWORKS else ""
    entry = measure_cell(Cell(subject, config, 300, 2), Config(repeats=3, cell_seconds=0.1), FAST)
    assert "ms" in entry, entry
    assert entry["compilations_afterwards"] == 0


def test_fields_are_written_twice_and_equal():
    from benchmarks._fields import fields_model, reference_fields

    model = fields_model("small")
    garment = garment_of(model.config, 300)
    betas = np.array([[0.7, -1.1], [-2.0, 0.4]], np.float32)
    reference = reference_fields("small", 300)
    for found, row in zip(jax.jit(drape)(model, garment, jnp.asarray(betas)), betas, strict=True):
        exact = reference.drape(row)
        np.testing.assert_allclose(np.asarray(found)[reference.mask], exact[reference.mask], atol=3e-6)


def test_the_reference_is_the_network():
    """Two levels, order 3, layer widths up and down: written twice, equal."""
    net = UNetConfig(widths=(6, 9), encoder_convs=1, order=3)
    config = paper_form(load_config("small", smooth=net, fine=net, num_levels=2))
    model = init_model(jax.random.key(3), config)
    mesh = mesh_of_size(300)
    graph = build_graph(mesh.mean, mesh.faces, model.body, num_levels=2, laplacian=config.laplacian)
    garment = Garment(graph, make_smoother(mesh.mean, mesh.faces, config.smoothing_length, graph.num_nodes))
    betas = jnp.array([[0.7, -1.1]])
    reference = ReferenceGraph(garment)
    stage = Stage(init_unet(jax.random.key(4), net, config.smooth_features), jnp.asarray(0.5))
    found = apply_stage(stage, graph, smooth_features(config, garment, betas))[:, 0]
    features = reference.smooth_features(config, np.asarray(betas[0], np.float64))
    np.testing.assert_allclose(found, reference.displacement(double(stage), features), atol=2e-6)
    draped = drape(model, garment, betas)[0]
    exact = reference.drape(model, np.asarray(betas[0]), config.fabrics[0])
    np.testing.assert_allclose(np.asarray(draped)[reference.mask], exact[reference.mask], atol=2e-6)


def test_operations_are_counted():
    net = init_unet(jax.random.key(0), UNetConfig(widths=(4,), encoder_convs=1, order=1), 5)
    shapes = layer_shapes(net, 100)
    assert shapes == [(100, 1, 5, 4), (100, 1, 4, 3)]
    flops, moved = work_of_layers([net], 100, 2, 700, 4)
    assert flops == 2 * 100 * 2 * (5 * 4 + 4 * 3)
    assert moved == 4 * (100 * 2 * (5 + 4 + 4 + 3) + 5 * 4 + 4 * 3)


def test_subdivision_keeps_the_surface():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    points, finer = subdivide(square, faces)
    assert len(points) == 4 + 5
    assert len(finer) == 8
    corners = points[finer]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(normals, np.tile([0, 0, 0.25], (8, 1)))


def test_times_are_taken_in_turns():
    order = []
    times = time_calls({"a": lambda t: order.append(("a", t)), "b": lambda t: order.append(("b", t))}, 4, 0.0)
    assert order == [("a", 0), ("b", 0)] + [(name, t) for t in range(3) for name in "ab"]
    assert {name: len(values) for name, values in times.items()} == {"a": 3, "b": 3}
    found = summary([0.001, 0.002, 0.004], samples=8, floor=0.0005)
    assert found["ms"] == pytest.approx(2.0)
    assert found["per_second"] == pytest.approx(4000)
    assert found["share_of_ceiling"] == pytest.approx(0.25)


def test_compilations_are_counted():
    function = jax.jit(lambda x: jnp.cos(x) * 3)
    x = jnp.ones(7)
    with counting_compilations() as first:
        function(x)
    with counting_compilations() as second:
        function(x + 0)
        function(x)
    assert (first.count, second.count) == (1, 0) or second.count <= 1
    assert first.seconds > 0


def test_the_machine_is_measured(monkeypatch):
    ceilings = measure_ceilings(64, 1, repeats=2)
    assert set(ceilings.dense) == {"float32", "bfloat16"}
    assert min(*ceilings.dense.values(), ceilings.bandwidth) > 0
    assert set(ceilings.by_megabytes) == {0.75, 3.0}
    assert FAST.floor(1e12, 1e9) == pytest.approx(1.0)
    assert FAST.floor(1e9, 1e12) == pytest.approx(10.0)
    assert integrate_power([(0.0, 100.0)]) is None
    assert integrate_power([(0.0, 100.0), (1.0, 200.0), (3.0, 200.0)]) == pytest.approx(550)
    assert _machine.nvidia("power.draw") == ""


def test_the_ceiling_of_the_memory_is_that_of_the_working_set():
    memory = Ceilings({"float32": 1e3}, 10.0, {1.0: 100.0, 100.0: 20.0, 1000.0: 10.0})
    assert memory.memory_speed() == 10.0
    assert [memory.memory_speed(size) for size in (0.1, 1.0, 10.0, 100.0, 5000.0)] == pytest.approx(
        [100.0, 100.0, 60.0, 20.0, 10.0]
    )
    # 1 GB at 100 GB/s in the cache, at 10 GB/s beyond it.
    assert memory.floor(0.0, 1e9, megabytes=0.5) == pytest.approx(0.01)
    assert memory.floor(0.0, 1e9) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("subject", "megabytes", "ceilings", "said"),
    [
        ("Laplacian product", 9.0, {}, "may fit in cache, no memory ceiling"),
        ("solver step", 9.0, {}, "may fit in cache, no memory ceiling"),
        ("Laplacian product", 600.0, {}, "158 %"),
        ("Laplacian product", 9.0, {"bandwidth_gb_s_by_mb": {"1.0": 9.0}}, "158 %"),
        ("drape", 9.0, {}, "158 %"),
    ],
)
def test_a_working_set_that_fits_in_a_cache_has_no_ceiling_of_memory(subject, megabytes, ceilings, said):
    cell = {"subject": subject, "memory_mb": megabytes, "share_of_ceiling": 1.58}
    assert report.ceiling_share(cell, ceilings) == said
    assert report.ceiling_share({"subject": subject}, ceilings) == "–"


def test_a_quick_run_writes_one_record(tmp_path, capsys):
    main(Config(subjects=("Laplacian product",), quick=True, minutes=0.0, out=tmp_path))
    [path] = tmp_path.glob("*.json")
    record = json.loads(path.read_text())
    assert record["benchmark"] == "compare"
    assert {"load_average", "clocks_mhz", "jax"} <= set(record["environment"])
    assert all(cell["skipped"] == "the 0 minutes were over" for cell in record["cells"])
    assert "0 cells timed" in capsys.readouterr().out


def test_a_record_is_continued_where_time_cut_it_off(tmp_path, monkeypatch):
    calls = []

    def measure(cell, config, ceilings):
        calls.append(cell)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return dataclasses.asdict(cell) | summary([0.001] * 3, 1, None) | {"beside": {}}

    monkeypatch.setattr(compare, "measure_cell", measure)
    config = Config(subjects=("Laplacian product",), quick=True, out=tmp_path)
    with pytest.raises(KeyboardInterrupt):
        main(config)
    [path] = tmp_path.glob("*.json")
    cells = json.loads(path.read_text())["cells"]
    assert ["ms" in cell for cell in cells] == [True, True, False]
    begun = path.read_text()
    with pytest.raises(ValueError, match="begun with repeats = 15, now it is 7"):
        main(dataclasses.replace(config, resume=True, repeats=7))
    assert path.read_text() == begun
    main(dataclasses.replace(config, resume=True, minutes=3.0))
    record = json.loads(path.read_text())
    assert calls == [*plan(config), plan(config)[2]]
    assert all("ms" in cell for cell in record["cells"])
    assert len(record["pieces"]) == 2
    main(dataclasses.replace(config, resume=True))
    assert len(calls) == 4
    main(config)
    assert len(calls) == 7


def test_larger_limits_let_in_what_was_too_much(tmp_path, monkeypatch):
    seconds = iter((3.2, 7.04, 0.1))
    calls = []

    def measure(cell, config, ceilings):
        calls.append(cell)
        if len(calls) <= 3:
            needed = next(seconds)
            return dataclasses.asdict(cell) | too_long(needed, needed)
        return dataclasses.asdict(cell) | summary([0.001] * 3, 1, None) | {"beside": {}}

    monkeypatch.setattr(compare, "measure_cell", measure)
    config = Config(subjects=("Laplacian product",), quick=True, out=tmp_path, max_call_seconds=0.05)
    main(config)
    main(dataclasses.replace(config, resume=True))
    assert len(calls) == 3
    main(dataclasses.replace(config, resume=True, max_call_seconds=5.0))
    assert calls[3:] == [plan(config)[0], plan(config)[2]]
    [path] = tmp_path.glob("*.json")
    record = json.loads(path.read_text())
    assert record["config"]["max_call_seconds"] == 5.0
    assert [cell.get("skipped") for cell in record["cells"]] == [None, "one call would take about 7.0 s", None]
    assert not measured(too_large(9.0), {"max_call_seconds": 1.0, "max_gigabytes": 9.0})


def test_a_cell_that_fails_costs_no_other_and_is_tried_again(tmp_path, monkeypatch):
    calls = []

    def measure(cell, config, ceilings):
        calls.append(cell)
        if len(calls) == 2:
            raise RuntimeError("out of memory\nat great length")
        return dataclasses.asdict(cell) | summary([0.001] * 3, 1, None) | {"beside": {}}

    monkeypatch.setattr(compare, "measure_cell", measure)
    config = Config(subjects=("Laplacian product",), quick=True, out=tmp_path)
    with pytest.raises(RuntimeError, match=r"1 cells failed, the first: .*out of memory"):
        main(config)
    [path] = tmp_path.glob("*.json")
    assert [cell.get("skipped") for cell in json.loads(path.read_text())["cells"]] == [
        None,
        "failed: out of memory",
        None,
    ]
    main(dataclasses.replace(config, resume=True))
    assert calls[3:] == [plan(config)[1]]
    assert all("ms" in cell for cell in json.loads(path.read_text())["cells"])


def record_of(platform: str, name: str, factor: float) -> dict:
    """A record as `compare` writes it, with known numbers."""

    def timed(batch: int, vertices: int) -> dict:
        cell = {"subject": "drape", "config": "small", "vertices": vertices, "batch": batch, "precision": "float32"}
        found = summary([factor * 1e-3 * batch] * 3, batch, 1e-4)
        return cell | found | {
            "compile_s": 1.0, "compilations": 1, "error": 1e-4, "unit": "mm", "memory_mb": 12.0,
            "beside": {"PyTorch Geometric": [factor * 4.0 * batch]},
        }  # fmt: skip

    huge = {"subject": "drape", "config": "small", "vertices": 3581, "batch": 256, "precision": "float32"}
    return {
        "benchmark": "compare",
        "environment": {
            "device": name, "platform": platform, "cpu_cores": 2, "date": "2020-01-01", "jax": "0",
            "load_average": [0.5],
        },
        "load_average_after": [1.5],
        "minutes": 1.0,
        "config": {"at_vertices": 3581, "at_batch": 8},
        "ceilings": {"dense_gflops": {"float32": 100.0}, "bandwidth_gb_s": 10.0},
        "cells": [timed(1, 3581), timed(8, 3581), timed(8, 1414), huge | {"skipped": "it would need about 9 GB"}],
    }  # fmt: skip


def test_records_are_merged_side_by_side(tmp_path):
    results = tmp_path / "results"
    results.mkdir()
    (results / "b.json").write_text(json.dumps(record_of("gpu", "A card", 0.1)))
    (results / "a.json").write_text(json.dumps(record_of("cpu", "A processor", 1.0)))
    (results / "other.json").write_text(json.dumps({"benchmark": "body"}))
    out = tmp_path / "docs" / "PAGE.md"
    report.main(report.Config(results, out))
    text = out.read_text()
    assert text.index("A processor") < text.index("A card")
    lines = [line for line in text.splitlines() if line.startswith("| small | 3581 | 8 |")]
    assert ["A processor" in line for line in lines] == [True, False]
    assert "8 (8 to 8)" in lines[0]
    assert "PyTorch Geometric 4.00×" in lines[0]
    assert lines[0].endswith("| – |")
    assert lines[1].endswith("| 10 |")
    assert "A card: drape small, vertices × batch 3,581 × 256: it would need about 9 GB." in text
    assert "No GPU" not in text
    [both] = [line for line in text.splitlines() if line.startswith("| drape | small | 3581 | 1 | float32 |")]
    assert both.split("|")[6:13] == [" 1e+03 ", " 10 % ", " – ", " 1e+04 ", " 100 % ", " – ", " 10 "]
    # What neither has measured has no line.
    assert not any(line.startswith("| side by side |  | 3581 | 64 |") for line in text.splitlines())
    aims = [line for line in text.splitlines() if "drapes a second with fields" in line]
    assert aims == ["| 100,000 drapes a second with fields | not measured | not measured |"]
    for name in ("benchmarks-batch.png", "benchmarks-vertices.png"):
        assert (out.parent / "images" / name).stat().st_size > 10_000
    report.main(report.Config(results, out, plots=False))
    (results / "b.json").unlink()
    report.main(report.Config(results, out, plots=False))
    assert "No GPU has been measured yet" in out.read_text()
    with pytest.raises(FileNotFoundError, match="no record of a comparison"):
        report.main(report.Config(tmp_path, out))


def test_aims_are_told_by_the_best_cell():
    def timed(subject: str, config: str, vertices: int, batch: int, ms: float, share: float | None) -> dict:
        cell = {"subject": subject, "config": config, "vertices": vertices, "batch": batch, "precision": "float32"}
        cell["memory_mb"] = 500.0
        return cell | summary([1e-3 * ms] * 3, batch, None) | ({} if share is None else {"share_of_ceiling": share})

    record = record_of("gpu", "A card", 1.0)
    record["cells"] = [
        timed("Chebyshev layer", "paper", 3581, 64, 1.0, 0.41),
        timed("Laplacian product", "paper", 3581, 64, 1.0, 0.62),
        timed("Laplacian product", "small", 3581, 64, 1.0, 0.93),
        timed("drape with fields", "small", 3581, 4096, 20.0, 0.1),
        timed("drape with fields", "small", 1414, 4096, 2.0, 0.1),
        timed("side by side", "", 3581, 64, 2000.0, None),
    ]
    lines = aims_table([record]).splitlines()[2:]
    assert "| not measured | 62 % (Laplacian product, 3,581 vertices × 64, A card) |" in lines[0]
    assert "204,800 (drape with fields, 3,581 vertices × 4,096, A card)" in lines[1]
    # 32 drapes a second.
    assert "15,276 drapes simulated in 10 minutes | not measured | 7.96 minutes at the rate" in lines[2]


def test_rounding_is_judged_by_the_size_of_what_is_computed():
    from benchmarks._subjects import rounding_mm

    exact = np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.25]])
    off = np.array([[0.0, 0.0, 0.0], [3e-6, 0.0, 4e-6]])
    assert rounding_mm(exact + off, exact) == pytest.approx(5e-3)
    assert rounding_mm(20 * exact + off, 20 * exact) == pytest.approx(5e-4)
