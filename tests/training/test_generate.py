"""Tasks of the dataset: planned once each, done once each, from the pattern to the files (small and coarse)."""

import csv
import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.garment.manifest import load_manifest
from tryon_jax.garment.pattern_map import map_patterns
from tryon_jax.physics.dressing import Diverged, Drape
from tryon_jax.training import drape_solver, generate
from tryon_jax.training import simulator as simulator_module
from tryon_jax.training.dataset import (
    STATISTICS,
    DatasetConfig,
    is_good,
    load_arrays,
    mesh_path,
    open_dataset,
)
from tryon_jax.training.generate import run_batch
from tryon_jax.training.plan import Task, batches, garment_names, plan, ray_numbers
from tryon_jax.training.protocol import make_protocol
from tryon_jax.training.samples import manifest_table, read_samples
from tryon_jax.training.simulator import Simulator

SMALL = DatasetConfig(fabrics=("gray-interlock",), target_area=8e-4, dense_vertices=900, reference_vertices=500)


def run_task(root: str, task: Task) -> str:
    return run_batch(root, (task,))


def waves(config: DatasetConfig, garments: list[str], rays: int, additional: bool = False) -> dict[str, list[Task]]:
    return dict(plan(config, load_manifest(), garments, rays, additional=additional))


def test_the_papers_plan() -> None:
    manifest = load_manifest()
    garments = garment_names(manifest, [d.label for d in manifest.training], manifest.training_seeds)
    assert len(garments) == 38
    planned = waves(DatasetConfig(), garments, rays=25)
    sizes = {title: len(tasks) for title, tasks in planned.items()}
    assert sizes == {
        "reference": 2,
        "mean body": 38,
        "mean body, other topologies": 38,
        "templates": 19,
        "rays": 38 * 25,
        "rays, other topologies": 38 * 25,
    }
    # Every file once.
    paths = [task.path(Path("x")) for tasks in planned.values() for task in tasks]
    assert len(set(paths)) == len(paths)
    # With the mean body, as many drapes as in the paper.
    rays = planned["rays"] + planned["rays, other topologies"]
    assert 76 + 8 * len(rays) == 19 * 2 * 2 * 201
    # Rays come after the drapes that they start from, and any beginning visits all garments.
    assert list(planned)[-2:] == ["rays", "rays, other topologies"]
    assert {task.garment for task in planned["rays"][:38]} == {name for name in garments if name.endswith("-0")}
    assert len({task.number for task in planned["rays"][:38]}) == 1


def test_fewer_rays_begin_the_same() -> None:
    few, every = (waves(SMALL, ["tank-0"], rays)["rays"] for rays in (2, 25))
    assert few == every[:2]
    assert waves(SMALL, ["tank-0"], rays=0)["rays"] == []


def test_additional_designs_share_the_directions_and_have_no_tests() -> None:
    protocol = make_protocol()
    numbers = [ray_numbers(protocol, 4, turn) for turn in range(25)]
    assert {number for four in numbers for number in four} == set(range(25))
    for four in numbers:
        gaps = np.diff([*sorted(four), min(four) + 25])
        assert gaps.max() <= 7
    rays = waves(SMALL, ["additional-0-0", "additional-1-0"], 4, additional=True)["rays"]
    assert all(task.training_only for task in rays)
    assert rays[0].number != rays[1].number


def test_templates_are_of_training_designs_alone() -> None:
    planned = waves(SMALL, ["tshirt-0", "tshirt-1", "unseen-tank-0"], 1)
    assert [task.path(Path("x")).name for task in planned["templates"]] == ["tshirt.npz"]


def test_additional_designs_stay_clear_of_the_unseen_ones() -> None:
    manifest = load_manifest()
    unseen = np.stack([design.values for design in manifest.unseen])
    additional = np.stack([design.values for design in manifest.additional])
    assert len(additional) == 1000
    assert np.linalg.norm(additional[:, None] - unseen[None], axis=2).min() > 0.03
    assert (additional >= manifest.space.minimum - 1e-9).all()
    assert (additional <= manifest.space.maximum + 1e-9).all()
    assert 20 <= len(manifest.validation) <= 60
    assert set(manifest.validation) <= {design.label for design in manifest.additional}


def test_unknown_designs_are_refused() -> None:
    with pytest.raises(ValueError, match="tanc"):
        garment_names(load_manifest(), ["tanc"], [0])


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of one garment: its mean drape, two shapes of one ray, one template."""
    root = open_dataset(tmp_path_factory.mktemp("dataset"), SMALL)
    simulator = generate._simulator(str(root))
    rays, test = (tuple(shapes[:2] for shapes in part) for part in (simulator.protocol.rays, simulator.protocol.test))
    simulator.protocol = dataclasses.replace(simulator.protocol, rays=rays, test=test)
    first = (Task("reference", fabric="gray-interlock"), Task("mean", "tank-0", "gray-interlock"))
    for task in (*first, Task("ray", "tank-0", "gray-interlock", 6)):
        line = run_task(str(root), task)
        assert "residual" in line
    return root


def test_a_garment_from_pattern_to_drape(root: Path) -> None:
    mesh = load_arrays(mesh_path(root, "tank-0"))
    mean = load_arrays(root / "mean" / "tank-0_gray-interlock.npz")
    assert mean["vertices"].shape == mean["slip"].shape == mesh["start"].shape
    assert mean["vertices"].dtype == np.float32
    assert {"jax", "numpy"} <= set(eval_versions(mean))
    statistics = {key: mean[key][None] for key in STATISTICS}
    assert is_good(statistics).all(), statistics
    # Worn: straps over the shoulders, hem round the hips, left and right alike.
    x = mean["vertices"]
    assert 0.4 < x[:, 1].max() < 0.6
    assert np.ptp(x[:, 1]) > 0.4
    assert abs(x[:, 0].max() + x[:, 0].min()) < 0.02


def eval_versions(arrays: dict[str, np.ndarray]) -> dict[str, str]:
    import json

    return json.loads(str(arrays["versions"]))


def test_a_ray_starts_from_the_mean_drape(root: Path) -> None:
    mean = load_arrays(root / "mean" / "tank-0_gray-interlock.npz")
    ray = load_arrays(root / "rays" / "tank-0_gray-interlock_06.npz")
    simulator = generate._simulator(str(root))
    np.testing.assert_allclose(ray["betas"], simulator.protocol.rays[6])
    np.testing.assert_array_equal(ray["test"], simulator.protocol.test[6])
    assert ray["vertices"].shape == (2, *mean["vertices"].shape)
    for key in STATISTICS:
        assert ray[key].shape == (2,)
    assert is_good(ray).all()
    # Moves with the body, millimetres for a shape, and ever farther from the mean.
    away = np.linalg.norm(ray["vertices"] - mean["vertices"], axis=2).mean(axis=1)
    assert 1e-4 < away[0] < away[1] < 0.05


def test_what_exists_is_not_done_again(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Simulator, tasks: list[Task]) -> list[str]:
        raise AssertionError("simulated again")

    monkeypatch.setattr(Simulator, "run", fail)
    task = Task("mean", "tank-0", "gray-interlock")
    before = task.path(root).stat().st_mtime_ns
    assert run_task(str(root), task) == ""
    assert run_task(str(root), dataclasses.replace(task, kind="ray", number=6)) == ""
    assert task.path(root).stat().st_mtime_ns == before


def test_the_stored_mesh_is_the_truth(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later change to the mesher must not change the garments of a dataset."""

    def fail(*args: object, **kwargs: object) -> None:
        raise AssertionError("meshed again")

    monkeypatch.setattr(simulator_module, "remesh", fail)
    mesh, cloth = Simulator(root).garment("tank-0")
    assert float(cloth.active.sum()) == len(mesh["start"])


def test_batches_hold_every_task_once_and_rays_of_one_garment() -> None:
    planned = waves(DatasetConfig(), ["tank-0", "tshirt-0"], rays=3)
    means, templates, rays = (planned[title] for title in ("mean body", "templates", "rays"))
    for wave, size in ((means, 3), (templates, 2), (rays, 4)):
        groups = batches(wave, size)
        assert {task for group in groups for task in group} == set(wave)
        assert sum(map(len, groups)) == len(wave)
        assert max(map(len, groups)) <= size
    assert all(len({task.garment for task in group}) == 1 for group in batches(rays, 4))
    assert batches([], 4) == []


def copy_of(root: Path, folder: Path) -> Path:
    """The dataset with its meshes and drapes on the mean body, without rays."""
    shutil.copytree(root, folder, ignore=shutil.ignore_patterns("rays"))
    return folder


def test_what_diverges_is_marked_and_not_left_out(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = Simulator(copy_of(root, tmp_path / "set"))
    task = Task("ray", "tank-0", "gray-interlock", 3)

    def diverges_at_the_second(first: Drape, *arguments: object) -> Iterator[Drape]:
        yield dataclasses.replace(first, report=dataclasses.replace(first.report, residual=jnp.asarray(0.001)))
        raise Diverged("the drape diverged")

    monkeypatch.setattr(drape_solver, "sweep", diverges_at_the_second)
    assert "diverged" in simulator.run([task])[0]
    ray = load_arrays(task.path(simulator.root))
    assert is_good(ray).tolist() == [True] + 7 * [False]
    assert np.isinf(ray["residual"][1:]).all()
    np.testing.assert_array_equal(ray["vertices"][7], simulator.garment("tank-0")[0]["start"].astype(np.float32))
    # A garment that cannot be draped at all: its mean drape is marked, and so are all shapes after it.
    mean = Task("mean", "tank-0", "gray-interlock")
    mean.path(simulator.root).unlink()

    def diverges(*arguments: object, **options: object) -> Drape:
        raise Diverged("the drape diverged")

    monkeypatch.setattr(drape_solver, "relax", diverges)
    assert "diverged" in simulator.run([mean])[0]
    assert not is_good(load_arrays(mean.path(simulator.root)))
    assert "diverged" in simulator.run([dataclasses.replace(task, number=4)])[0]
    assert not is_good(load_arrays(dataclasses.replace(task, number=4).path(simulator.root))).any()


@pytest.mark.slow
def test_another_topology_starts_from_the_first_at_each_body(root: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    shutil.copytree(root, folder)
    simulator = generate._simulator(str(folder))
    rays, test = (tuple(shapes[:2] for shapes in part) for part in (simulator.protocol.rays, simulator.protocol.test))
    simulator.protocol = dataclasses.replace(simulator.protocol, rays=rays, test=test)
    with pytest.raises(FileNotFoundError, match="tank-1 starts from the drapes of tank-0"):
        run_task(str(folder), Task("ray", "tank-1", "gray-interlock", 9))
    for task in (Task("mean", "tank-1", "gray-interlock"), Task("ray", "tank-1", "gray-interlock", 6)):
        assert "residual" in run_task(str(folder), task)
    first, second = (load_arrays(folder / "rays" / f"tank-{k}_gray-interlock_06.npz") for k in (0, 1))
    assert "slip" in first
    assert "slip" not in second
    onto = map_patterns(*(load_arrays(mesh_path(folder, f"tank-{k}")) for k in (1, 0)))
    assert np.linalg.norm(onto(first["vertices"]) - second["vertices"], axis=2).mean() < 3e-3


def test_the_manifest_lists_every_sample(root: Path) -> None:
    samples = read_samples(root)
    assert len(samples) == 1 + 2
    lines = list(csv.DictReader(manifest_table(root, samples, load_manifest()).splitlines()))
    assert [line["row"] for line in lines] == ["", "0", "1"]
    assert lines[0]["file"] == "mean/tank-0_gray-interlock.npz"
    assert lines[0]["split"] == "training"
    ray = load_arrays(root / "rays" / "tank-0_gray-interlock_06.npz")
    for row, line in enumerate(lines[1:]):
        assert line["split"] == ("test" if ray["test"][row] else "training")
        assert [float(beta) for beta in line["betas"].split()] == pytest.approx(ray["betas"][row], rel=1e-5)
        assert float(line["residual"]) == pytest.approx(float(ray["residual"][row]), rel=1e-5)
        assert (line["kept"], line["broken_rules"]) == ("yes", "")
        assert (line["design"], line["topology_seed"]) == ("tank", "0")
    tight = dataclasses.replace(samples[1], statistics=samples[1].statistics | {"tension": 400.0, "depth": 0.002})
    [line] = csv.DictReader(manifest_table(root, [tight], load_manifest()).splitlines())
    assert (line["kept"], line["broken_rules"]) == ("no", "depth tension")


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
def test_side_by_side_writes_the_same_files(root: Path, tmp_path: Path) -> None:
    folder = copy_of(root, tmp_path / "set")
    simulator = generate._simulator(str(folder))
    rays, test = (tuple(shapes[:2] for shapes in part) for part in (simulator.protocol.rays, simulator.protocol.test))
    simulator.protocol = dataclasses.replace(simulator.protocol, rays=rays, test=test)
    tasks = [Task("ray", "tank-0", "gray-interlock", number) for number in (6, 12)]
    assert "2 side by side" in run_batch(str(folder), tasks)
    assert run_batch(str(folder), tasks) == ""
    alone, together = (load_arrays(where / "rays" / "tank-0_gray-interlock_06.npz") for where in (root, folder))
    assert set(alone) == set(together)
    np.testing.assert_array_equal(alone["betas"], together["betas"])
    assert is_good(together).all()
    # Two runs that differ by rounding end in other folds, millimetres apart.
    assert np.linalg.norm(alone["vertices"] - together["vertices"], axis=2).mean() < 2e-3


def test_a_ray_without_its_mean_drape_says_so(root: Path) -> None:
    with pytest.raises(FileNotFoundError, match="tank-0_white-dots-on-blk"):
        run_task(str(root), Task("ray", "tank-0", "white-dots-on-blk", 0))
