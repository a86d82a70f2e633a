import io
import re
import shlex
from collections.abc import Iterator
from dataclasses import replace

import jax
import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.belt import snug_belt
from tests.flat_model import flat_model
from tests.tryon.test_learned_stance import with_stance
from tryon_jax.body import load_body
from tryon_jax.mesh.repair import repair_mesh
from tryon_jax.render.fit_maps import MAPS, map_colors
from tryon_jax.viewer.downloads import (
    command_line,
    legend,
    mesh_file,
    pattern_file,
    picture_file,
)
from tryon_jax.viewer.page_model import LAYERS, PageModel, UploadedMesh
from tryon_jax.wear.gate import Refused


@pytest.fixture(scope="module")
def page():
    return PageModel(flat_model(target_area=1.5e-3))


@pytest.fixture(scope="module")
def result(page):
    # The flat panels cut through the body, which is far from what a push can mend; the gate would refuse to write them.
    finished = page.finish(page.compute(replace(page.start(), push_out=False)))
    assert finished.dressed.verdict.outcome == "refused"
    return replace(finished, dressed=replace(finished.dressed, verdict=None))


def test_what_the_gate_refuses_is_not_downloaded(page):
    finished = page.finish(page.compute(replace(page.start(), push_out=False)))
    with pytest.raises(Refused, match="is refused"):
        mesh_file(finished.dressed, ".glb")


@pytest.fixture
def compilations() -> Iterator[list[str]]:
    """Names of what JAX compiles during the test."""
    names: list[str] = []

    def note(event: str, _: float, **about: object) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            names.append(str(about))

    jax.monitoring.register_event_duration_secs_listener(note)
    yield names
    jax.monitoring.unregister_event_duration_listener(note)


def test_every_layer_is_a_mesh(result):
    assert set(result.layers) == set(LAYERS)
    for surface in result.layers.values():
        assert surface.faces.max() < len(surface.vertices)
        assert np.isfinite(surface.vertices).all()
    assert np.ptp(result.layers["panels"].vertices[:, 2]) == 0
    assert len(result.layers["template on the mean body"].vertices) == 403


def test_betas_change_the_body_and_prepare_nothing(page, result):
    taller = page.compute(replace(result.settings, betas=(2.0, 0.0)))
    assert taller.dressed.body.measurements["stature"] > result.dressed.body.measurements["stature"] + 0.05
    assert "graph" not in taller.seconds
    assert taller.dressed.garment is result.dressed.garment


def test_nothing_is_compiled_for_another_design_body_or_fabric_seen_before(page, result, compilations):
    fabrics = page.session.fabrics
    for fabric in fabrics:
        page.compute(replace(result.settings, fabric=fabric))
    compilations.clear()
    longest = tuple(float(v) for v in page.session.space.maximum)
    other = page.finish(page.compute(replace(result.settings, design=longest, seed=3)))
    assert len(other.layers["drape"].vertices) > 1.3 * len(result.layers["drape"].vertices)
    assert {"pattern and mesh", "graph", "drape", "fit"} <= set(other.seconds)
    tank = tuple(page.session.space.preset("tank").values)
    page.finish(page.compute(replace(result.settings, design=tank, betas=(0.3, -0.7), fabric=fabrics[-1])))
    assert compilations == []


def test_compilations_are_seen(compilations):
    jax.jit(lambda x: x + 41.5)(np.float32(1))
    assert compilations != []


def test_a_moved_slider_takes_the_triangles_along_until_the_result_is_finished(page, result):
    before = page.finish(page.compute(page.start()))
    design = tuple(np.array(before.settings.design) + 0.005)
    moving = page.compute(replace(before.settings, design=design), before)
    assert moving.dressed.garment.near is before.dressed.garment
    np.testing.assert_array_equal(moving.layers["drape"].faces, before.layers["drape"].faces)
    finished = page.finish(moving)
    assert finished.dressed.garment.near is None
    assert finished.dressed.garment.design == page.session.prepare(design).design
    assert finished.dressed.fit is not None
    assert finished.layers["drape"].vertices.shape == finished.dressed.vertices.shape


def test_measurements_lead_to_a_body_that_has_them(page, result):
    fit = page.session.body_of({"stature": 1.70})
    betas = tuple(float(b) for b in fit.betas)
    assert page.compute(replace(result.settings, betas=betas)).dressed.body.measurements["stature"] == pytest.approx(
        1.70, abs=0.005
    )
    low, high = page.tape_ranges(("stature",))["stature"]
    assert low < result.dressed.body.measurements["stature"] < high


@pytest.mark.parametrize(
    ("change", "message"),
    [({"fabric": "silk"}, "unknown fabric"), ({"design": (9.0, 1.0, 0.8)}, "sleeve_length = 9 m is outside")],
)
def test_impossible_settings_are_refused(page, result, change, message):
    with pytest.raises(ValueError, match=message):
        page.compute(replace(result.settings, **change))


def test_a_mesh_of_ones_own_is_pushed_out_and_has_no_pattern(page, result):
    own = UploadedMesh("belt.obj", repair_mesh(*snug_belt()))
    worn = page.compute(replace(result.settings, own=own, push_out=True))
    finished = page.finish(worn)
    assert finished.dressed.pushed is not None
    assert finished.dressed.pushed.inside_before > 0
    assert finished.dressed.fit is not None
    assert finished.dressed.fit.inside == 0
    np.testing.assert_array_equal(finished.layers["fine stage"].vertices, worn.layers["drape"].vertices)
    assert "template on the mean body" not in finished.layers
    with pytest.raises(ValueError, match="no pattern"):
        pattern_file(finished.dressed, page.session.space)
    assert "--garment belt.obj" in command_line(finished.settings, page.session.space)


@pytest.mark.slow
def test_another_body_is_dressed_in_its_own_size(result):
    page = PageModel(flat_model(target_area=1.5e-3), replace(load_body("male"), name="mine"))
    assert page.dresses_another_body
    assert len(page.start().betas) == 10
    other = page.compute(page.start())
    assert other.dressed.body.measurements["stature"] > result.dressed.body.measurements["stature"] + 0.05
    # The sleeves reach as far down the longer arms as the shoulders moved out.
    wide, usual = (np.ptp(one.layers["fine stage"].vertices[:, 0]) for one in (other, result))
    assert wide > usual


def test_downloads_are_what_they_say(page, result):
    scene = trimesh.load(io.BytesIO(mesh_file(result.dressed, ".glb")), file_type="glb", process=False)
    assert set(scene.geometry) == {"body", "garment"}
    obj = mesh_file(result.dressed, ".obj")
    assert b"mtllib" not in obj
    assert obj.count(b"\nf ") == len(result.body("drape").faces) + len(result.dressed.faces)
    whole = trimesh.load(io.BytesIO(obj), file_type="obj", process=False)
    assert len(whole.faces) == len(result.body("drape").faces) + len(result.dressed.faces)
    svg = pattern_file(result.dressed, page.session.space).decode()
    # True size: one unit of the drawing is one millimetre on paper.
    width, height, box = re.search(r'width="([\d.]+)mm" height="([\d.]+)mm" viewBox="0 0 ([\d. ]+)"', svg).groups()
    assert box == f"{width} {height}"
    for colors in (None, "ease"):
        with Image.open(io.BytesIO(picture_file(result.dressed, colors))) as image:
            assert image.format == "PNG"


def test_maps_colour_every_vertex(result):
    for name in MAPS:
        assert map_colors(result.dressed.fit, name).shape == result.layers["drape"].vertices.shape
        assert MAPS[name].label in legend(name)


def test_the_command_line_makes_the_same(page, result, tmp_path, monkeypatch):
    from tryon_jax.cli import main
    from tryon_jax.tryon import model_file, save_model

    # The page's model, made by hand, has no skin to keep off.
    monkeypatch.setattr(model_file, "keep_off_skin", lambda model: model)
    save_model(tmp_path / "model.safetensors", page.session.model)
    settings = replace(
        result.settings, betas=(0.5, -0.25), design=tuple(page.session.space.preset("tshirt").values), seed=2
    )
    words = shlex.split(command_line(settings, page.session.space, ("--weights", "model.safetensors")))
    monkeypatch.chdir(tmp_path)
    assert main([*words[1:], "--height", "40", "--views", "front", "--no-gate"]) == 0
    garment = trimesh.load("garment.glb", process=False).geometry["garment"]
    drape = page.compute(settings).layers["drape"]
    np.testing.assert_allclose(garment.triangles, drape.vertices[drape.faces], atol=1e-4)


def test_arms_come_down_in_the_drape_and_stay_up_in_the_other_layers(page, tmp_path):
    assert not page.lowers_arms
    assert page.start().arms == 0.0
    model = with_stance(page.session.model)
    lowered = PageModel(model)
    assert lowered.lowers_arms
    settings = replace(lowered.start(), push_out=False)
    assert settings.arms == 45.0
    result = lowered.compute(settings)
    assert result.seen.arms == 45.0
    assert result.dressed.arms == 0.0
    np.testing.assert_array_equal(result.layers["drape"].vertices, result.seen.vertices)
    hand = np.abs(result.dressed.body.vertices[:, 0]).argmax()
    heights = [result.body(layer).vertices[hand, 1] for layer in ("drape", "panels", "fine stage")]
    assert heights[0] < heights[1] - 0.3
    assert heights[1] == heights[2]
    finished = lowered.finish(result)
    assert finished.dressed.fit is not None
    assert finished.seen.fit is finished.dressed.fit
    assert "--arms 45" in command_line(settings, lowered.session.space)
    assert lowered.compute(replace(settings, arms=0.0)).standing is None
