"""The page in a real browser. Screenshots go to `artifacts/`."""

import io
import os
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from headless_browser import PROGRAM, Browser
from PIL import Image

from tests.belt import snug_belt
from tests.flat_model import flat_model
from tryon_jax.viewer import serve
from tryon_jax.viewer.upload import MAX_BYTES
from tryon_jax.wear import session, simulate
from tryon_jax.wear.gate import Verdict

pytestmark = [pytest.mark.browser, pytest.mark.skipif(PROGRAM is None, reason="no Chromium on this machine")]
ARTIFACTS = Path(os.environ.get("TRYON_ARTIFACTS", "artifacts"))


@pytest.fixture(scope="module")
def url():
    with pytest.MonkeyPatch.context() as patch:
        # The flat panels cut through the body, which is far from what a push can mend: it is not waited for.
        patch.setattr(session, "push_out", partial(session.push_out, max_rounds=1))
        # Nor would the gate let them be downloaded.
        patch.setattr(session, "judge", lambda *_, **__: Verdict())
        server = serve(flat_model(target_area=1.5e-3), port=8765)
        assert server.get_host() == "127.0.0.1"
        yield f"http://127.0.0.1:{server.get_port()}"
        server.stop()


@pytest.fixture(scope="module")
def page(url):
    with Browser(url) as browser:
        browser.wait(lambda: "hip" in report(browser), "the report of the fit")
        browser.click("push out of the body")
        browser.wait(lambda: "push out:" not in browser.text(), "the drape as it is")
        browser.click("Take away")
        browser.wait(lambda: "GLB" in browser.text(), "the folder to open")
        yield browser


def report(browser: Browser) -> str:
    text = browser.text()
    return text[text.find("\nFit") : text.find("\nTime")] if "\nFit" in text else ""


def shoot(browser: Browser, name: str) -> None:
    """Keep a picture of the page, once the scene is drawn."""
    ARTIFACTS.mkdir(exist_ok=True, parents=True)
    time.sleep(2)
    browser.screenshot(ARTIFACTS / f"viewer-{name}.png")


def garment(browser: Browser) -> trimesh.Trimesh:
    scene = trimesh.load(io.BytesIO(browser.download("GLB", "garment.glb")), file_type="glb", process=False)
    assert set(scene.geometry) == {"body", "garment"}
    return scene.geometry["garment"]


def test_the_mesh_follows_the_sliders(page):
    shoot(page, "start")
    first = garment(page)
    before, length = report(page), page.value_of("length, cm")
    page.drag_slider("length, cm", 15)
    page.wait(lambda: "graph:" in page.text() and report(page) != before, "another garment")
    page.wait(lambda: "inside" in report(page), "its fit")
    longer = garment(page)
    moved = page.value_of("length, cm") - length
    assert moved > 1
    # Texture coordinates are metres on the pattern.
    grown = np.ptp(longer.visual.uv[:, 1]) - np.ptp(first.visual.uv[:, 1])
    assert 100 * grown == pytest.approx(moved, abs=0.2)
    assert "slider to drape" in page.text()

    before = report(page)
    page.type_into("beta 1", "2")
    page.wait(lambda: report(page).split("garment")[0] != before.split("garment")[0], "another body")
    page.wait(lambda: "inside" in report(page), "its fit")
    shoot(page, "changed")
    assert page.errors == []


def test_layers_and_maps_are_shown(page):
    for layer in ("panels", "template on the mean body", "smooth stage", "drape"):
        page.choose("layer", layer)
        if layer in ("panels", "template on the mean body"):
            shoot(page, layer.split()[0])
    page.choose("colour", "ease")
    page.wait(lambda: "distance from the body, cm" in page.text(), "the legend")
    shoot(page, "ease")
    page.choose("colour", "plain")
    page.click("wireframe")
    shoot(page, "wireframe")
    page.click("wireframe")
    assert page.errors == []


def test_downloads_are_valid(page):
    assert len(garment(page).faces) > 100
    obj = page.download("OBJ", "garment.obj")
    assert len(trimesh.load(io.BytesIO(obj), file_type="obj", process=False).faces) == obj.count(b"\nf ") > 1000
    assert b'viewBox="0 0 ' in page.download("pattern (SVG, true size)", "pattern.svg")
    with Image.open(io.BytesIO(page.download("picture", "garment.png"))) as image:
        assert image.format == "PNG"
        assert np.ptp(np.asarray(image)) > 100
    assert page.errors == []


def test_bad_uploads_are_refused_and_good_ones_worn(page, tmp_path):
    broken, large, belt = tmp_path / "broken.glb", tmp_path / "large.obj", tmp_path / "belt.ply"
    broken.write_bytes(b"glTF but not really")
    with large.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    trimesh.Trimesh(*snug_belt(), process=False).export(belt)
    page.hand_in(broken)
    page.wait(lambda: "broken.glb" in page.text() and "That did not work" in page.text(), "the message")
    page.hand_in(large)
    page.wait(lambda: "at most 20 MB are taken" in page.text(), "the message")
    shoot(page, "refused")
    page.hand_in(belt)
    page.wait(lambda: "wearing belt.ply" in page.text(), "the belt")
    page.wait(lambda: "--garment belt.ply" in page.text() or "--garment belt.ply" in command(page), "its command")
    page.click("back to the pattern")
    page.wait(lambda: "wearing" not in page.text(), "the pattern")
    assert page.errors == []


def command(browser: Browser) -> str:
    return str(browser.evaluate("[...document.querySelectorAll('textarea')].map(e => e.value).join(' ')"))


def test_two_visitors_have_their_own_state(url, page):
    with Browser(url) as other:
        other.wait(lambda: "hip" in report(other), "the second page")
        before = report(other).split("garment")[0]
        page.type_into("beta 1", "-2")
        page.wait(lambda: report(page).split("garment")[0] != before, "the first page to change")
        assert report(other).split("garment")[0] == before
        assert other.errors == []
    assert page.errors == []


@pytest.mark.slow
def test_a_simulation_runs_beside_and_can_be_cancelled(page, monkeypatch):
    # A garment this small may be at rest before a busy browser shows the button: it is held until that is pressed.
    pressed, dress = threading.Event(), simulate.dress

    def held(*arguments, **options):
        drape = dress(*arguments, **options)
        assert pressed.wait(300)
        return drape

    monkeypatch.setattr(simulate, "dress", held)
    page.click("Compare with a simulation")
    page.wait(lambda: "simulate this garment" in page.text(), "the folder to open")
    page.click("simulate this garment")
    page.wait(lambda: "dressing the mean body" in page.text(), "the start")
    page.click("cancel")
    page.wait(lambda: "stopping" in page.text(), "the button to be heard")
    pressed.set()
    page.wait(lambda: "cancelled" in page.text(), "the end", seconds=180)
    shoot(page, "simulation")
    assert page.errors == []
