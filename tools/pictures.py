"""Make the pictures of the README and the documentation with the program itself: python tools/pictures.py [NAME...]

The page in a browser needs Chromium; it is driven as in the tests.
"""

import sys
import tempfile
import time
from pathlib import Path

from tryon_jax.cli import main as tryon

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
COMMANDS = {
    "drape.jpg": "drape --design dress --betas 1.5 -0.5 --fabric gray-interlock --height 640 --picture",
    "body.jpg": "body --stature 1.72 --chest 0.96 --height 560 --picture",
    "pattern.jpg": "pattern --design dress --picture",
}
"""Each picture and the command line that makes it."""
PAGE = "viewer.jpg"
"""The picture of the page."""


def photograph_page(path: Path) -> None:
    """Open the try-on in a headless Chromium, move a few sliders, and keep what is seen."""
    sys.path.insert(0, str(ROOT / "tests" / "viewer"))
    from headless_browser import Browser
    from PIL import Image

    from tryon_jax.tryon import load_pretrained
    from tryon_jax.viewer import serve

    server = serve(load_pretrained())
    with Browser(f"http://127.0.0.1:{server.get_port()}", (1360, 1000)) as browser:

        def is_measured() -> bool:
            report = browser.text().split("\nFit")[-1]
            return "inside" in report and "measuring" not in report

        browser.wait(is_measured, "the first drape")
        # Headless browsers are warned of drawing without a GPU.
        browser.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(e => e.click())")
        for label, value in (("beta 1", "1.5"), ("beta 2", "-0.5")):
            browser.type_into(label, value)
            time.sleep(2)
        browser.wait(is_measured, "the drape")
        time.sleep(3)
        with tempfile.TemporaryDirectory() as folder:
            screenshot = browser.screenshot(Path(folder) / "page.png")
            Image.open(screenshot).convert("RGB").save(path, quality=90)
    server.stop()


def main() -> int:
    """Make the pictures that are named, or all."""
    for name in sys.argv[1:] or (*COMMANDS, PAGE):
        if name == PAGE:
            photograph_page(IMAGES / name)
        elif code := tryon([*COMMANDS[name].split(), str(IMAGES / name)]):
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
