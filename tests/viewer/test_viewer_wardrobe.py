import io
import shlex
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from flat_model import flat_model
from PIL import Image

from tryon_jax.viewer.takeaway import MAPS, command_line, map_colors, mesh_file, pattern_file, picture_file
from tryon_jax.viewer.wardrobe import LAYERS, Wardrobe


@pytest.fixture(scope="module")
def wardrobe():
    return Wardrobe(flat_model(target_area=1.5e-3))


@pytest.fixture(scope="module")
def look(wardrobe):
    return wardrobe.look(wardrobe.start())


def test_every_layer_is_a_mesh(look):
    assert set(look.layers) == set(LAYERS)
    for surface in look.layers.values():
        assert surface.faces.max() < len(surface.vertices)
        assert np.isfinite(surface.vertices).all()
    assert np.ptp(look.layers["panels"].vertices[:, 2]) == 0
    assert len(look.layers["template on the mean body"].vertices) == 403


def test_betas_change_the_body_and_prepare_nothing(wardrobe, look):
    taller = wardrobe.look(replace(look.wish, betas=(2.0, 0.0)))
    assert taller.measured["stature"] > look.measured["stature"] + 0.05
    assert "graph" not in taller.seconds
    assert taller.mesh is look.mesh


def test_another_design_runs_the_code_that_is_compiled(wardrobe, look):
    before = wardrobe._drape._cache_size()
    longest = tuple(float(v) for v in wardrobe.space.maximum)
    other = wardrobe.look(replace(look.wish, design=longest, seed=3))
    assert len(other.layers["drape"].vertices) > 1.3 * len(look.layers["drape"].vertices)
    assert {"pattern and mesh", "graph", "drape", "fit"} <= set(other.seconds)
    assert wardrobe._drape._cache_size() == before


def test_measurements_lead_to_a_body_that_has_them(wardrobe, look):
    fit = wardrobe.body_of({"stature": 1.70})
    betas = tuple(float(b) for b in fit.betas)
    assert wardrobe.look(replace(look.wish, betas=betas)).measured["stature"] == pytest.approx(1.70, abs=0.005)
    low, high = wardrobe.tape_ranges(("stature",))["stature"]
    assert low < look.measured["stature"] < high


@pytest.mark.parametrize(
    ("change", "message"),
    [({"fabric": "silk"}, "unknown fabric"), ({"design": (9.0, 1.0, 0.8)}, "sleeve_length = 9 m is outside")],
)
def test_impossible_wishes_are_refused(wardrobe, look, change, message):
    with pytest.raises(ValueError, match=message):
        wardrobe.look(replace(look.wish, **change))


def test_downloads_are_what_they_say(wardrobe, look):
    scene = trimesh.load(io.BytesIO(mesh_file(look, ".glb")), file_type="glb", process=False)
    assert set(scene.geometry) == {"body", "garment"}
    assert mesh_file(look, ".obj").startswith(b"mtllib")
    svg = pattern_file(look, wardrobe.space)
    assert b"<svg" in svg
    assert b"mm" in svg
    with Image.open(io.BytesIO(picture_file(look))) as image:
        assert image.format == "PNG"


def test_maps_colour_every_vertex(look):
    for name in MAPS:
        assert map_colors(look, name).shape == look.layers["drape"].vertices.shape


def test_the_command_line_makes_the_same(wardrobe, look, tmp_path, monkeypatch):
    from tryon_jax.cli import main
    from tryon_jax.tryon import save_model

    save_model(tmp_path / "model.safetensors", wardrobe.model)
    wish = replace(look.wish, betas=(0.5, -0.25), design=tuple(wardrobe.space.preset("tshirt").values), seed=2)
    words = shlex.split(command_line(wish, wardrobe.space))
    monkeypatch.chdir(tmp_path)
    options = ["--weights", "model.safetensors", "--no-push-out", "--height", "40", "--views", "front"]
    assert main([*words[1:], *options]) == 0
    garment = trimesh.load("garment.glb", process=False).geometry["garment"]
    drape = wardrobe.look(wish).layers["drape"]
    np.testing.assert_allclose(garment.triangles, drape.vertices[drape.faces], atol=1e-4)
