"""A headless Chromium, driven over its debugging protocol with nothing but a WebSocket."""

import base64
import itertools
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path

from websockets.sync.client import connect

PROGRAM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


class Browser:
    """One page in one browser process; use it in a `with` block."""

    def __init__(self, url: str, size: tuple[int, int] = (1280, 800)) -> None:
        self.folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--use-angle=swiftshader"]
        options += ["--enable-unsafe-swiftshader", "--no-first-run", "--remote-debugging-port=0"]
        options += [f"--window-size={size[0]},{size[1]}", f"--user-data-dir={self.folder.name}/profile"]
        self.process = subprocess.Popen(
            [str(PROGRAM), *options, "about:blank"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        port_file = Path(self.folder.name) / "profile" / "DevToolsActivePort"
        self.wait(lambda: port_file.exists() and port_file.read_text().count("\n") >= 1, "the browser to start")
        port = port_file.read_text().split()[0]
        pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list"))
        target = next(page for page in pages if page["type"] == "page")
        self.socket = connect(target["webSocketDebuggerUrl"], max_size=None)
        self.numbers = itertools.count(1)
        self.errors: list[str] = []
        self.downloads = Path(self.folder.name) / "downloads"
        self.downloads.mkdir()
        for domain in ("Runtime", "Page", "Log"):
            self.call(f"{domain}.enable")
        self.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(self.downloads))
        self.call("Page.navigate", url=url)

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()
        self.process.kill()
        self.process.wait()
        self.folder.cleanup()

    def call(self, method: str, **parameters: object) -> dict:
        """Send a command and return its result; what the page reports meanwhile is noted."""
        number = next(self.numbers)
        self.socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self.socket.recv(timeout=120))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message: dict) -> None:
        event, details = message.get("method"), message.get("params", {})
        if event == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(details["exceptionDetails"])[:500])
        elif event == "Log.entryAdded" and details["entry"]["level"] == "error":
            self.errors.append(f"{details['entry']['text']} {details['entry'].get('url', '')}")
        elif event == "Runtime.consoleAPICalled" and details["type"] == "error":
            self.errors.append(json.dumps(details["args"])[:500])

    def evaluate(self, expression: str) -> object:
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def text(self) -> str:
        """Everything that can be read on the page."""
        return str(self.evaluate("document.body ? document.body.innerText : ''"))

    def find(self, label: str, kinds: str = "label, p, span, div, button, legend") -> str:
        """JavaScript of the innermost, last element that says exactly `label`."""
        return (
            f"[...document.querySelectorAll({kinds!r})].filter("
            f"e => e.textContent.trim() === {label!r} && ![...e.children].some(c => c.textContent.trim() === {label!r})"
            ").pop()"
        )

    def click(self, label: str) -> None:
        """Click on what says `label`, once it is there: the page shows its parts one after the other."""
        # In one piece: between a look and a click the page may draw its parts anew.
        click = f"(part => {{ if (part) part.click(); return part !== undefined; }})({self.find(label)})"
        self.wait(lambda: self.evaluate(click), f"{label!r} to appear", seconds=60)

    def _in_row(self, label: str, selector: str) -> str:
        """JavaScript of the first element that matches `selector` in the row called `label`."""
        return (
            f"(() => {{ let row = {self.find(label)};"
            f" while (!row.querySelector({selector!r})) row = row.parentElement;"
            f" return row.querySelector({selector!r}); }})()"
        )

    def type_into(self, label: str, value: str) -> None:
        """Type into the field of the control called `label`."""
        self.evaluate(f"(field => {{ field.focus(); field.select(); }})({self._in_row(label, 'input[type=text]')})")
        self.call("Input.insertText", text=value)
        self.press("Enter", 13)

    def press(self, key: str, code: int) -> None:
        """Press a key where the focus is."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def value_of(self, label: str) -> float:
        """What stands in the number field of the slider called `label`."""
        return float(str(self.evaluate(f"{self._in_row(label, 'input[type=text]')}.value")))

    def drag_slider(self, label: str, pixels: int) -> None:
        """Drag the thumb of the slider called `label` with the mouse."""
        box = f"(box => [box.x + box.width / 2, box.y + box.height / 2])({self._in_row(label, '[role=slider]')}"
        x, y = self.evaluate(f"{box}.getBoundingClientRect())")
        for kind, at in (("mousePressed", x), ("mouseMoved", x + pixels), ("mouseReleased", x + pixels)):
            held = {"button": "left", "buttons": 1, "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=kind, x=at, y=y, **held)

    def choose(self, label: str, option: str) -> None:
        """Choose `option` in the list called `label`."""
        self.evaluate(f"(field => {{ field.focus(); field.click(); }})({self._in_row(label, 'input')})")
        entry = f"[...document.querySelectorAll('[role=option]')].find(e => e.textContent.trim() === {option!r})"
        self.wait(lambda: self.evaluate(f"{entry} !== undefined"), f"the option {option!r}")
        self.evaluate(f"{entry}.click()")

    def hand_in(self, path: Path) -> None:
        """Choose a file in the page's only file field."""
        root = self.call("DOM.getDocument")["root"]["nodeId"]
        field = self.call("DOM.querySelector", nodeId=root, selector="input[type=file]")["nodeId"]
        self.call("DOM.setFileInputFiles", nodeId=field, files=[str(path)])

    def download(self, label: str, name: str) -> bytes:
        """Press the button called `label` and return the file that comes."""
        target = self.downloads / name
        target.unlink(missing_ok=True)
        self.click(label)
        self.wait(lambda: target.exists() and target.stat().st_size > 0, f"the download {name}")
        return target.read_bytes()

    def screenshot(self, path: Path) -> Path:
        """Write what the page looks like."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
        return path

    @staticmethod
    def wait(condition, what: str, seconds: float = 240.0) -> None:
        """Wait until `condition()` is true."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"waited {seconds:g} s for {what}"
            time.sleep(0.1)
