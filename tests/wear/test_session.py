"""One object from design, body and fabric to the fitted garment and its file."""

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import trimesh

import tryon_jax as tj
from benchmarks._machine import counting_compilations
from tests.flat_model import flat_model
from tryon_jax.body import load_body
from tryon_jax.garment.pattern_map import map_patterns, pattern_arrays
from tryon_jax.mesh.repair import repair_mesh
from tryon_jax.physics.fabrics import fabric_names
from tryon_jax.wear.stopwatch import Stopwatch


@pytest.fixture(scope="module")
def session():
    return tj.Session(flat_model(), triangle_area=1.2e-3)


@pytest.fixture(scope="module")
def belt():
    """Cloth a little inside the hips of the mean body."""
    body = load_body("female")
    vertices = np.asarray(body.v_template)
    near = (np.abs(vertices[:, 1]) < 0.06) & (np.abs(vertices[:, 0]) < 0.25)
    faces = np.asarray(body.faces)[near[np.asarray(body.faces)].all(axis=1)]
    mesh = trimesh.Trimesh(vertices * [0.985, 1, 0.985], faces)
    return repair_mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def test_a_session_drapes_what_the_library_drapes(session):
    garment = session.prepare("dress")
    dressed = session.drape(garment, (0.5, -1.0), fabric="camel-ponte-roma")
    expected = garment.garment.unpad(
        tj.drape(session.model, garment.garment, np.array([0.5, -1.0]), fabric="camel-ponte-roma")
    )
    np.testing.assert_allclose(dressed.vertices, expected, atol=1e-6)
    np.testing.assert_array_equal(dressed.fine, dressed.vertices)
    assert dressed.fit is None
    assert dressed.pushed is None


def test_the_first_fabric_and_the_mean_body_are_the_defaults(session):
    dressed = session.try_on(clearance=None)
    assert dressed.fabric == session.fabrics[0]
    np.testing.assert_array_equal(dressed.body.betas, [0.0, 0.0])
    np.testing.assert_array_equal(dressed.garment.design.values, session.space.mean)
    assert dressed.fit is not None


def test_what_does_not_change_is_made_once(session):
    first = Stopwatch()
    garment = session.prepare("tshirt", stopwatch=first)
    again = Stopwatch()
    assert session.prepare("tshirt", stopwatch=again) is garment
    assert {"pattern and mesh", "graph"} <= set(first.seconds)
    assert not again.seconds
    assert session.prepare("tshirt", seed=1) is not garment
    mean = session.shape()
    assert session.shape((0.0, 0.0)) is mean
    for k in range(1, 12):
        session.shape((0.1 * k,))
    assert session.shape() is not mean, "only the last shapes are kept"


def test_cloth_is_pushed_out_and_measured_again(session, belt):
    garment = session.prepare(mesh=belt, label="belt")
    assert garment.design is None
    assert not garment.has_pattern
    drape = session.drape(garment)
    assert drape.penetration().depth > 1e-3
    dressed = session.measure(session.push_out(drape))
    assert dressed.pushed.is_outside
    assert dressed.penetration().depth == 0
    assert dressed.fit.inside == 0
    # Girths and distances that are known are not measured again; measured again they are the same.
    again = session.measure(replace(dressed, pushed=None, body=replace(dressed.body, measurements={})))
    assert again.fit.body_girth == dressed.fit.body_girth
    np.testing.assert_allclose(again.fit.clearance, dressed.fit.clearance, rtol=0, atol=1e-12)
    whole = session.try_on(garment)
    np.testing.assert_array_equal(whole.vertices, dressed.vertices)
    np.testing.assert_array_equal(whole.fine, drape.vertices)


def test_a_mesh_file_that_changes_is_read_again(session, belt, tmp_path):
    path = tmp_path / "belt.ply"
    trimesh.Trimesh(belt.vertices, belt.faces, process=False).export(path)
    first = session.prepare(mesh=path)
    assert first.label == "belt.ply"
    assert session.prepare(mesh=path) is first
    trimesh.Trimesh(belt.vertices + [0, 0.01, 0], belt.faces, process=False).export(path)
    assert session.prepare(mesh=path) is not first


def test_a_pose_turns_both_and_keeps_the_fit(session):
    dressed = session.try_on("tank", clearance=None)
    pose = np.zeros((len(session.body.parents), 3))
    pose[0] = [0.0, np.pi / 2, 0.0]
    posed = session.pose(dressed, pose)
    for before, after in ((dressed.vertices, posed.vertices), (dressed.body.vertices, posed.body.vertices)):
        x, y, z = before.T
        np.testing.assert_allclose(after, np.stack([z, y, -x], axis=1), atol=1e-5)
    assert posed.fit is dressed.fit


def test_files_hold_body_and_garment(session, tmp_path):
    dressed = session.try_on("dress", clearance=None)
    dressed.write(tmp_path / "dress.glb")
    assert set(trimesh.load(tmp_path / "dress.glb", process=False).geometry) == {"body", "garment"}
    with pytest.raises(ValueError, match=r"suffix '\.fbx' is none of"):
        dressed.write(tmp_path / "dress.fbx")


def test_another_body_is_dressed_and_not_posed():
    session = tj.Session(flat_model(), body=replace(load_body("male"), name="mine"), triangle_area=1.2e-3)
    assert session.num_betas == 10
    garment = session.prepare("dress")
    dressed = session.drape(garment)
    assert len(dressed.body.known_betas) == 2
    assert dressed.body.measurements["stature"] > 1.7
    with pytest.raises(ValueError, match="stays in T-pose"):
        session.pose(dressed, np.zeros((24, 3)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.try_on("dres"), "did you mean 'dress'"),
        (lambda s: s.try_on({"length": 90.0}), "length = 90 m is outside"),
        (lambda s: s.try_on(betas=(1.0, 2.0, 3.0)), "betas has 3 numbers, but only the first 2 are known"),
        (lambda s: s.try_on(betas=(np.nan,)), "betas must be finite"),
        (lambda s: s.try_on(fabric="silk"), "unknown fabric 'silk'"),
        (lambda s: s.prepare("dress", mesh="dress.obj"), "a design or a mesh, not both"),
    ],
)
def test_what_makes_no_sense_is_refused(session, call, message):
    with pytest.raises(ValueError, match=message):
        call(session)


def test_measurements_name_a_body(session):
    fit = session.body_of({"stature": 1.7})
    assert session.shape(np.asarray(fit.betas)).measurements["stature"] == pytest.approx(1.7, abs=5e-3)


def test_a_near_design_takes_the_triangles_along(session):
    """Also from a garment that did so itself; one that is too far, has another seed or is known is made as always."""
    carried = session.prepare("tshirt")
    assert session.prepare({"chest": 1.03}, near=carried).near is None, "a mesh of another density moves with another"
    session = tj.Session(flat_model(target_area=1.2e-3))
    first = session.prepare({"chest": 1.02, "length": 0.64})
    near = session.prepare({"chest": 1.03, "length": 0.65}, near=first)
    assert near.near is first
    assert near.faces is first.faces
    assert near.design is not None
    assert near.design.as_dict()["chest"] == 1.03
    assert near.garment.graph.levels is first.garment.graph.levels
    assert np.abs(near.uv - first.uv).max() > 1e-3
    further = session.prepare({"chest": 1.04, "length": 0.65}, near=near)
    assert further.near is first
    far = session.prepare({"chest": 1.17, "length": 1.2}, near=first)
    assert far.near is None
    assert session.prepare({"chest": 1.03, "length": 0.65}, seed=3, near=first).near is None
    anew = session.prepare({"chest": 1.03, "length": 0.65})
    assert anew.near is None
    assert session.prepare({"chest": 1.03, "length": 0.65}, near=first) is anew
    # On its new triangles the same cloth lies in the same place.
    onto = map_patterns(pattern_arrays(near.mesh), pattern_arrays(anew.mesh))
    there = onto(anew.garment.mean_vertices[None])[0]
    assert np.linalg.norm(near.garment.mean_vertices - there, axis=1).mean() < 5e-3


@pytest.fixture(scope="module")
def any_fabric():
    """A session whose networks take every fabric; they are zero, so that all fabrics drape alike."""
    return tj.Session(flat_model(shared_fabrics=("gray-interlock", "royal-target")), triangle_area=1.2e-3)


def test_a_network_of_all_fabrics_takes_every_name_and_files(any_fabric, tmp_path):
    assert any_fabric.fabrics[:2] == ("gray-interlock", "camel-ponte-roma")
    assert set(any_fabric.fabrics) == set(fabric_names())
    path = tmp_path / "mine.toml"
    source = resources.files("tryon_jax").joinpath("data/fabrics.toml").read_text()
    path.write_text("[mine" + source.partition("[tango-red-jet-set")[2].partition("\n[")[0])
    garment = any_fabric.prepare("tank")
    for fabric in ("tango-red-jet-set", str(path)):
        dressed = any_fabric.measure(any_fabric.drape(garment, (0.5,), fabric=fabric))
        assert dressed.fabric == fabric
        assert dressed.fit is not None
        assert dressed.fit.pull, "the fabric's tables tell how hard it pulls"


def test_another_fabric_compiles_nothing(any_fabric):
    garment = any_fabric.prepare("tank")
    any_fabric.drape(garment, fabric="white-swim-solid")
    with counting_compilations() as count:
        any_fabric.drape(garment, fabric="pink-ribbon-brown")
    assert count.count == 0


def test_a_fabric_file_needs_a_network_of_all_fabrics(session, any_fabric, tmp_path):
    with pytest.raises(ValueError, match="unknown fabric"):
        session.drape(session.prepare("tank"), fabric=str(tmp_path / "mine.toml"))
    with pytest.raises(FileNotFoundError, match="fabric file"):
        any_fabric.drape(any_fabric.prepare("tank"), fabric=str(tmp_path / "gone.toml"))
