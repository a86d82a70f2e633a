"""Sliders give the drape back as nearly as they say, in the file as in memory."""

import json

import numpy as np
import pytest
import trimesh

from tests.flat_model import flat_model
from tryon_jax.body import shape_body
from tryon_jax.files.morph_glb import Morphs, write_morph_glb
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.morph_targets import fit_morph_targets, fitted_shares, target_names, target_weights, write_morphs
from tryon_jax.wear.session import Session

DTYPES = {5125: "<u4", 5126: "<f4"}


class Made(Session):
    """A session whose drapes are a known function of the betas."""

    wave = 0.0

    def drape(self, garment, betas=(), *, fabric="gray-interlock", stopwatch=None):
        body = self.shape(betas, stopwatch=stopwatch)
        a, b = np.asarray(betas) / self.model.config.beta_ranges
        x, y, z = garment.garment.mean_vertices.T
        moved = np.stack([x + 0.05 * a * y, y - 0.1 * abs(b) * x, z + 0.2 * a * b + self.wave * np.sin(3 * a)], axis=1)
        return DressedBody(body, garment, fabric, moved, moved, moved)


@pytest.fixture(scope="module")
def session():
    return Made(flat_model(target_area=2.5e-3))


@pytest.fixture
def morphs(session):
    return fit_morph_targets(session, session.prepare("tank"), "gray-interlock", outside=False)


def test_names_and_weights_of_the_targets():
    assert target_names(2) == ("beta1+", "beta1-", "beta2+", "beta2-", "beta1*beta2")
    np.testing.assert_array_equal(target_weights(np.array([0.5, -1.0])), [0.5, 0, 0, 1, -0.5])
    assert len(target_names(3)) == target_weights(np.zeros((4, 3))).shape[1] == 9
    assert fitted_shares(2).min() == -1
    assert len(fitted_shares(3)) > len(target_names(3))


def test_what_the_targets_can_say_is_exact(morphs, session):
    assert morphs.error.largest < 1e-5
    # Without the product each vertex is off by 0.2 m times a b, a quarter of which is the mean over the square.
    assert morphs.sliders.mean == pytest.approx(0.05, rel=0.4)
    betas = np.array([1.7, -0.9])
    wanted = session.drape(morphs.garment, betas).vertices
    np.testing.assert_allclose(morphs.apply(betas), wanted, atol=1e-6)


def test_the_error_is_that_of_bodies_that_were_not_fitted(session, monkeypatch):
    monkeypatch.setattr(Made, "wave", 0.02)
    morphs = fit_morph_targets(session, session.prepare("tank"), "gray-interlock", outside=False)
    rng = np.random.default_rng(5)
    bodies = rng.uniform(-1, 1, (40, 2)) * morphs.extent
    wanted = np.array([session.drape(morphs.garment, betas).vertices for betas in bodies])
    far = np.linalg.norm(morphs.apply(bodies) - wanted, axis=2)
    assert 1e-3 < morphs.error.mean < 1e-2
    assert np.mean(far) == pytest.approx(morphs.error.mean, rel=0.3)
    assert np.max(far) <= 1.2 * morphs.error.largest


def read(path):
    data = path.read_bytes()
    assert data[:4] == b"glTF"
    version, size, length = np.frombuffer(data[4:16], "<u4")
    assert (version, size) == (2, len(data))
    document = json.loads(data[20 : 20 + length])
    binary = data[28 + length :]
    assert document["buffers"][0]["byteLength"] == len(binary)

    def array(number):
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        part = binary[view["byteOffset"] :][: view["byteLength"]]
        rows = np.frombuffer(part, DTYPES[accessor["componentType"]]).reshape(accessor["count"], -1)
        if "min" in accessor:
            np.testing.assert_array_equal(rows.min(axis=0), np.array(accessor["min"], rows.dtype))
            np.testing.assert_array_equal(rows.max(axis=0), np.array(accessor["max"], rows.dtype))
        return rows

    return document, array


def test_the_file_moves_body_and_garment_together(morphs, session, tmp_path):
    path = tmp_path / "tank.glb"
    write_morphs(path, morphs, np.array([1.5, -0.5], np.float32))
    document, array = read(path)
    (mesh,) = document["meshes"]
    about = mesh["extras"]["tryon_jax"]
    assert mesh["extras"]["targetNames"] == list(morphs.names)
    assert about["error_m"]["largest"] == morphs.error.largest
    np.testing.assert_allclose(mesh["weights"], morphs.weights(np.array([1.5, -0.5])))
    betas = np.array([-2.0, 1.2])
    weights = morphs.weights(betas)
    made = []
    for primitive in mesh["primitives"]:
        targets = [array(target["POSITION"]) for target in primitive["targets"]]
        assert len(targets) == len(morphs.names)
        for target in primitive["targets"]:
            normals = array(primitive["attributes"]["NORMAL"]) + array(target["NORMAL"])
            np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
        points = array(primitive["attributes"]["POSITION"]) + np.tensordot(weights, targets, 1)
        made.append(points[array(primitive["indices"]).ravel()])
    body, _ = shape_body(session.body, betas)
    np.testing.assert_allclose(made[0], np.asarray(body)[np.asarray(session.body.faces).ravel()], atol=1e-5)
    np.testing.assert_allclose(made[1], morphs.apply(betas)[morphs.garment.faces.ravel()], atol=1e-5)
    (animation,) = document["animations"]
    times, frames = (array(animation["samplers"][0][key]) for key in ("input", "output"))
    assert len(frames) == len(times) * len(morphs.names)
    assert (np.diff(times[:, 0]) > 0).all()
    assert frames.reshape(len(times), -1).max(axis=0).tolist() == [1, 1, 1, 1, 0]
    scene = trimesh.load(path, process=False)
    assert sum(len(geometry.faces) for geometry in scene.geometry.values()) == len(made[0]) // 3 + len(made[1]) // 3


def test_other_numbers_of_names_and_targets_are_refused(tmp_path):
    some = Morphs(names=("a", "b"), weights=np.zeros(1), frames=np.zeros((2, 1)), seconds=1.0, extras={})
    with pytest.raises(ValueError, match="1 targets where 2 have names"):
        write_morph_glb(tmp_path / "x.glb", "x", [], some)
    assert not list(tmp_path.iterdir())
