"""A catalogue is the same however it is cut, and nothing of it is done twice or lost."""

import csv
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.flat_model import flat_model
from tryon_jax.cli import main
from tryon_jax.commands import _catalogue, catalogue
from tryon_jax.commands._request import Request
from tryon_jax.training.dataset import load_arrays
from tryon_jax.tryon import model_file, save_model
from tryon_jax.wear.dressed import DressedBody


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "flat.safetensors"
    save_model(path, flat_model(target_area=2.5e-3))
    return str(path)


@pytest.fixture
def lists(tmp_path, monkeypatch):
    """Two garments and five bodies; the work is done in this process."""
    monkeypatch.setattr(catalogue, "open_pool", lambda *_: ThreadPoolExecutor(1))
    garments, bodies = tmp_path / "designs.csv", tmp_path / "bodies.csv"
    garments.write_text("name,design,garment_length,fabric\nlong,dress,1.0,\nshort,tshirt,,camel-ponte-roma\n")
    bodies.write_text("name,betas,stature\nann,1 0.5,\nbea,-1,\ncleo,,1.7\nmean,,\nzoe,0 2,\n")
    return garments, bodies


def arguments(lists, weights, out, *more):
    paths = ["--garments", str(lists[0]), "--bodies", str(lists[1]), "--out", str(out), "--weights", weights]
    return ["catalogue", *paths, "--processes", "1", *more]


def test_designs_come_block_by_block_and_meshes_mesh_by_mesh(tmp_path):
    """So bodies are made once for many garments, and what is dear to prepare is prepared once."""
    garments = [Request("one", mesh=tmp_path / "one.obj"), Request("two"), Request("three"), Request("four")]
    garments[2] = replace(garments[2], mesh=tmp_path / "three.obj")
    betas = np.zeros((5, 2), np.float32)
    options = _catalogue.Options(fabric="gray-interlock", block=3)
    tasks = _catalogue.open_catalogue(tmp_path, _catalogue.Catalogue(garments, list("abcde"), betas, options))
    assert [task[1:] for task in tasks] == [(0, 0), (0, 1), (2, 0), (2, 1), (1, 0), (3, 0), (1, 1), (3, 1)]


# Flat panels cut through the body, which is far from what a push can mend.
QUICK = ("--no-push-out", "--no-fit", "--block", "4")


def read(path):
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_every_garment_is_draped_on_every_body_and_nothing_twice(lists, weights, tmp_path, capsys, monkeypatch):
    # The drapes of networks that are zero enter the body.
    monkeypatch.setattr(model_file, "keep_off_skin", lambda model: model)
    out = tmp_path / "out"
    assert main(arguments(lists, weights, out, *QUICK)) == 0
    said = capsys.readouterr().out
    assert "2 garments × 5 bodies; 0 of 4 blocks were done before" in said
    assert "10 not judged" in said
    rows = read(out / "fit.csv")
    assert [(row["name"], row["body"]) for row in rows] == [
        (garment, body) for garment in ("long", "short") for body in ("ann", "bea", "cleo", "mean", "zoe")
    ]
    assert [row["fabric"] for row in rows[4:6]] == ["gray-interlock", "camel-ponte-roma"]
    first, last = (load_arrays(out / "long" / f"{block:05d}.npz") for block in (0, 1))
    assert first["names"].tolist() == ["ann", "bea", "cleo", "mean"]
    assert last["names"].tolist() == ["zoe"]
    np.testing.assert_array_equal(first["betas"][[0, 1, 3]], [[1, 0.5], [-1, 0], [0, 0]])
    assert first["offsets"].dtype == np.float16
    # All networks of this model are zero: every body gets the same drape.
    np.testing.assert_allclose(first["mean"] + first["offsets"][1], last["mean"], atol=1e-5)
    times = {path: path.stat().st_mtime_ns for path in out.rglob("*.npz")}
    (out / "short" / "00001.npz").unlink()
    lists[0].write_text(lists[0].read_text().replace("long,dress,1.0", "long,dress,0.9") + "third,tank,,\n")
    assert main(arguments(lists, weights, out, *QUICK)) == 0
    assert "3 garments × 5 bodies; 1 of 6 blocks were done before" in capsys.readouterr().out
    assert len(read(out / "fit.csv")) == 15
    after = {path: path.stat().st_mtime_ns for path in out.rglob("*.npz")}
    same = [path.relative_to(out).as_posix() for path in times if after[path] == times[path]]
    assert same == ["short/00000.npz"]


def test_what_is_written_is_as_near_as_the_table_says(lists, weights, tmp_path):
    """Fields of a random size in place of zero ones: drapes that differ by centimetres."""
    rng = np.random.default_rng(0)
    session = _catalogue.open_session(weights, None, 4)
    prepared = session.prepare("tank")
    vertices = prepared.garment.mean_vertices
    drapes = [vertices + 0.05 * rng.normal(size=vertices.shape).astype(np.float32) for _ in range(3)]
    dressed = [DressedBody(session.shape(), prepared, "gray-interlock", drape, drape, drape) for drape in drapes]
    path = tmp_path / "x.npz"
    rounding = _catalogue._write_drapes(path, prepared, [(str(k), d, None) for k, d in enumerate(dressed)])
    found = load_arrays(path)
    errors = np.linalg.norm(found["mean"] + found["offsets"].astype(np.float32) - np.array(drapes), axis=2).max(axis=1)
    np.testing.assert_allclose(list(rounding.values()), errors, atol=1e-9)
    assert 0 < errors.max() < 1e-4


def test_meshes_with_the_body_and_what_is_refused(lists, weights, tmp_path, capsys):
    out = tmp_path / "out"
    lists[0].write_text("name,design\nlong,dress\n")
    lists[1].write_text("name,betas\nann,1 0.5\nmean,\n")
    glb = ("--format", "glb", "--body-mesh", "--no-push-out")
    assert main(arguments(lists, weights, out, *glb, "--no-gate")) == 0
    scene = trimesh.load(out / "long" / "ann.glb", process=False)
    assert set(scene.geometry) == {"body", "garment"}
    (out / "long" / "mean.glb").unlink()
    assert main(arguments(lists, weights, out, *glb, "--no-gate")) == 0
    assert (out / "long" / "mean.glb").is_file()
    # The same with the gate belongs to another folder.
    assert main(arguments(lists, weights, out, *glb)) == 1
    assert "holds another catalogue: gate = False (asked for True); choose another folder" in capsys.readouterr().err
    (row, _) = read(out / "fit.csv")
    assert row["body"] == "ann"
    assert float(row["ease_chest"]) == pytest.approx(float(row["garment_girth_chest"]) - float(row["body_girth_chest"]))
    assert row["outcome"] in ("fine", "warning", "refused")


def test_all_bad_rows_of_both_files_are_named(lists, weights, tmp_path, capsys):
    out = tmp_path / "out"
    lists[0].write_text("name,design,fabric\na,dress,\nb,dres,\nc,dress,silk\n")
    lists[1].write_text("name,betas,waist\nmean,,\nfar,9 9,\nthin,,0.1\n")
    assert main(arguments(lists, weights, out)) == 1
    said = capsys.readouterr().err
    assert "4 of 6 rows cannot be draped" in said
    for words in ("garment b: unknown", "garment c: unknown fabric 'silk'", "body far: ", "body thin: waist"):
        assert words in said
    lists[0].write_text("name,betas\na,1\n")
    lists[1].write_text("name,betas\nmean,x\n")
    assert main(arguments(lists, weights, out)) == 1
    said = capsys.readouterr().err
    assert "unknown column of designs.csv 'betas'" in said
    assert "row 1 of bodies.csv: betas must be a number, got 'x'" in said
    lists[0].write_text("name,design\n..,dress\n")
    assert main(arguments(lists, weights, out)) == 1
    assert "name = '..' must be a plain file name" in capsys.readouterr().err
    assert not out.exists()
    for more, words in ((("--body-mesh",), "for --format glb"), (("--block", "0"), "--block = 0")):
        assert main(arguments(lists, weights, out, *more)) == 1
        assert words in capsys.readouterr().err


def test_a_drape_that_fails_is_said_and_tried_again(lists, weights, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    lists[0].write_text("name,design\nlong,dress\n")
    finish = _catalogue._finish

    def fail(session, dressed, options):
        if dressed.body.betas[0] == -1:
            raise FloatingPointError("no number")
        return finish(session, dressed, options)

    with monkeypatch.context() as patch:
        patch.setattr(_catalogue, "_finish", fail)
        assert main(arguments(lists, weights, out, *QUICK)) == 1
    assert "1 of 5 drapes failed, see fit.csv" in capsys.readouterr().err
    assert [row["error"] for row in read(out / "fit.csv")] == ["", "no number", "", "", ""]
    assert main(arguments(lists, weights, out, *QUICK)) == 0
    assert "1 of 2 blocks were done before" in capsys.readouterr().out
    assert load_arrays(out / "long" / "00000.npz")["names"].tolist() == ["ann", "bea", "cleo", "mean"]
