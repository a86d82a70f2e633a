"""Tasks of the dataset: planned once each, done once each, from the pattern to the files (small and coarse)."""

import csv
import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tryon_jax.garment.manifest import load_manifest
from tryon_jax.physics.dressing import Diverged, Drape
from tryon_jax.training import bench as bench_module
from tryon_jax.training import generate
from tryon_jax.training.dataset import STATISTICS, DatasetConfig, is_good, load_arrays, mesh_path, open_dataset
from tryon_jax.training.generate import (
    Bench,
    Task,
    batches,
    garment_names,
    plan,
    run_batch,
    run_task,
    template_designs,
)
from tryon_jax.training.samples import manifest_table, read_samples

SMALL = DatasetConfig(fabrics=("gray-interlock",), target_area=8e-4, dense_vertices=900)


def test_the_papers_plan() -> None:
    manifest = load_manifest()
    garments = garment_names(manifest, [d.label for d in manifest.training], manifest.training_seeds)
    assert len(garments) == 38
    means, templates, rays = plan(DatasetConfig(), garments, rays=25, templates=120)
    assert [len(wave) for wave in (means, templates, rays)] == [76, 120, 76 * 25]
    assert {task.kind for task in means} == {"mean"}
    assert {task.kind for task in templates} == {"template"}
    # Every file once.
    paths = [task.path(Path("x")) for task in means + templates + rays]
    assert len(set(paths)) == len(paths)
    # With the mean body, as many drapes as in the paper.
    assert 76 + 8 * len(rays) == 19 * 2 * 2 * 201
    # Rays come after the drapes that they start from, and any beginning visits all garments.
    assert {task.kind for task in rays} == {"ray"}
    assert {task.garment for task in rays[:76]} == set(garments)
    assert len({task.number for task in rays[:76]}) == 1


def test_fewer_rays_begin_the_same() -> None:
    few = plan(SMALL, ["tank-0"], rays=2, templates=0)[2]
    all_rays = plan(SMALL, ["tank-0"], rays=25, templates=0)[2]
    assert few == all_rays[:2]
    means, templates, none = plan(SMALL, ["tank-0"], rays=0, templates=0)
    assert (len(means), templates, none) == (1, [], [])


def test_designs_for_the_mean_drape() -> None:
    manifest = load_manifest()
    designs = template_designs(manifest, 60)
    assert designs[:19] == list(manifest.training)
    labels = [design.label for design in designs]
    assert len(set(labels)) == 60
    values = np.array([design.values for design in designs])
    assert (values >= manifest.space.minimum - 1e-9).all()
    assert (values <= manifest.space.maximum + 1e-9).all()
    # Asking for more does not change those before... as long as the sequence has the same length.
    np.testing.assert_allclose(values, np.array([design.values for design in template_designs(manifest, 64)])[:60])
    assert template_designs(manifest, 5) == designs[:5]
    unseen = {tuple(design.values.tolist()) for design in manifest.unseen}
    assert not unseen & set(map(tuple, values.tolist()))


def test_unknown_designs_are_refused() -> None:
    with pytest.raises(ValueError, match="tanc"):
        garment_names(load_manifest(), ["tanc"], [0])


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of one garment: its mean drape, two shapes of one ray, one template."""
    root = open_dataset(tmp_path_factory.mktemp("dataset"), SMALL)
    bench = generate._bench(str(root))
    rays, test = (tuple(shapes[:2] for shapes in part) for part in (bench.protocol.rays, bench.protocol.test))
    bench.protocol = dataclasses.replace(bench.protocol, rays=rays, test=test)
    for task in (Task("mean", "tank-0", "gray-interlock"), Task("ray", "tank-0", "gray-interlock", 6)):
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
    bench = generate._bench(str(root))
    np.testing.assert_allclose(ray["betas"], bench.protocol.rays[6])
    np.testing.assert_array_equal(ray["test"], bench.protocol.test[6])
    assert ray["vertices"].shape == (2, *mean["vertices"].shape)
    for key in STATISTICS:
        assert ray[key].shape == (2,)
    assert is_good(ray).all()
    # Moves with the body, millimetres for a shape, and ever farther from the mean.
    away = np.linalg.norm(ray["vertices"] - mean["vertices"], axis=2).mean(axis=1)
    assert 1e-4 < away[0] < away[1] < 0.05


def test_what_exists_is_not_done_again(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Bench, task: Task) -> str:
        raise AssertionError("simulated again")

    monkeypatch.setattr(Bench, "simulate_mean", fail)
    monkeypatch.setattr(Bench, "simulate_ray", fail)
    task = Task("mean", "tank-0", "gray-interlock")
    before = task.path(root).stat().st_mtime_ns
    assert run_task(str(root), task) == ""
    assert run_task(str(root), dataclasses.replace(task, kind="ray", number=6)) == ""
    assert task.path(root).stat().st_mtime_ns == before


def test_the_stored_mesh_is_the_truth(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later change to the mesher must not change the garments of a dataset."""

    def fail(*args: object, **kwargs: object) -> None:
        raise AssertionError("meshed again")

    monkeypatch.setattr(bench_module, "remesh", fail)
    mesh, cloth = Bench(root).garment("tank-0")
    assert float(cloth.active.sum()) == len(mesh["start"])


def test_batches_hold_every_task_once_and_rays_of_one_garment() -> None:
    means, templates, rays = plan(DatasetConfig(), ["tank-0", "tshirt-0"], rays=3, templates=5)
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
    bench = Bench(copy_of(root, tmp_path / "set"))
    task = Task("ray", "tank-0", "gray-interlock", 3)
    first = bench._resume(task, bench._worn("tank-0", "gray-interlock"))

    def lost_at_the_second(*arguments: object) -> Iterator[Drape]:
        yield first
        raise Diverged("the drape diverged")

    monkeypatch.setattr(bench_module, "sweep", lost_at_the_second)
    assert "lost" in bench.simulate_ray(task)
    ray = load_arrays(task.path(bench.root))
    assert is_good(ray).tolist() == [True] + 7 * [False]
    assert np.isinf(ray["residual"][1:]).all()
    np.testing.assert_array_equal(ray["vertices"][7], first.vertices)
    # A garment that cannot be dressed at all: its mean drape is marked, and so are all shapes after it.
    mean = Task("mean", "tank-0", "gray-interlock")
    mean.path(bench.root).unlink()

    def undressable(*arguments: object) -> Drape:
        raise Diverged("the drape diverged")

    monkeypatch.setattr(bench_module, "dress", undressable)
    assert "lost" in bench.simulate_mean(mean)
    assert not is_good(load_arrays(mean.path(bench.root)))
    assert "lost" in bench.simulate_ray(dataclasses.replace(task, number=4))
    assert not is_good(load_arrays(dataclasses.replace(task, number=4).path(bench.root))).any()


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
    bench = generate._bench(str(folder))
    rays, test = (tuple(shapes[:2] for shapes in part) for part in (bench.protocol.rays, bench.protocol.test))
    bench.protocol = dataclasses.replace(bench.protocol, rays=rays, test=test)
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
