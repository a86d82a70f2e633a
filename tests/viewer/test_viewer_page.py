"""The page in a real browser. Screenshots go to `artifacts/`."""

import time
from pathlib import Path

import pytest
import trimesh
from flat_model import flat_model
from headless_browser import PROGRAM, Browser

from tryon_jax.viewer import serve

pytestmark = [pytest.mark.browser, pytest.mark.skipif(PROGRAM is None, reason="no Chromium on this machine")]
ARTIFACTS = Path("artifacts")


@pytest.fixture(scope="module")
def url():
    server = serve(flat_model(target_area=1.5e-3), port=8765)
    assert server.get_host() == "127.0.0.1"
    yield f"http://127.0.0.1:{server.get_port()}"
    server.stop()


@pytest.fixture
def page(url):
    with Browser(url) as browser:
        browser.wait(lambda: "hip" in report(browser), "the report of the fit")
        yield browser


def report(browser: Browser) -> str:
    text = browser.text()
    return text[text.find("\nFit") :] if "\nFit" in text else ""


def set_number(browser: Browser, label: str, value: str) -> None:
    """Type into the number field beside the slider called `label`."""
    browser.evaluate(
        f"""(() => {{
            const name = [...document.querySelectorAll('label, p, span, div')]
                .filter(e => e.children.length === 0 && e.textContent.trim() === {label!r}).pop();
            let row = name;
            while (!row.querySelector('input[type=text]')) row = row.parentElement;
            const field = row.querySelector('input[type=text]');
            field.focus(); field.select();
        }})()"""
    )
    browser.call("Input.insertText", text=value)
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13)


def click(browser: Browser, label: str) -> None:
    """Click on the button or heading called `label`."""
    browser.evaluate(
        f"""[...document.querySelectorAll('button, legend, span, p, div')]
            .filter(e => e.textContent.trim() === {label!r}).pop().click()"""
    )


def test_the_page_follows_the_sliders_without_errors(page):
    ARTIFACTS.mkdir(exist_ok=True)
    page.screenshot(ARTIFACTS / "viewer-start.png")
    before = report(page)
    set_number(page, "beta 1", "2")
    page.wait(lambda: report(page).split("garment")[0] != before.split("garment")[0], "another body")
    before = report(page)
    set_number(page, "length, cm", "110")
    page.wait(lambda: "graph:" in report(page), "another garment")
    assert report(page) != before
    time.sleep(1)
    page.screenshot(ARTIFACTS / "viewer-changed.png")
    assert page.errors == []


def test_what_is_downloaded_is_a_mesh(page):
    click(page, "Take away")
    page.wait(lambda: "GLB" in page.text(), "the folder to open")
    click(page, "GLB")
    target = page.downloads / "garment.glb"

    page.wait(lambda: target.exists() and target.stat().st_size > 0, "the download")
    assert set(trimesh.load(target, process=False).geometry) == {"body", "garment"}


def test_two_visitors_have_their_own_state(url, page):
    with Browser(url) as other:
        other.wait(lambda: "hip" in report(other), "the second page")
        before = report(other).split("garment")[0]
        set_number(page, "beta 1", "-2")
        page.wait(lambda: report(page).split("garment")[0] != before, "the first page to change")
        assert report(other).split("garment")[0] == before
