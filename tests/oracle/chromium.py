"""A real browser without a screen, driven through its DevTools protocol."""

import base64
import itertools
import json
import shutil
import subprocess
import time
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")


def find():
    """The program, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One tab. Use it as a context manager."""

    def __init__(self, folder, size=(960, 640)):
        from websockets.sync.client import connect

        self._process = subprocess.Popen(
            [
                find(), "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-extensions",
                "--disable-dev-shm-usage", "--disable-background-networking", "--remote-debugging-port=0",
                f"--user-data-dir={folder}", f"--window-size={size[0]},{size[1]}", "about:blank",
            ],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            note = Path(folder) / "DevToolsActivePort"
            until(lambda: note.is_file() and len(note.read_text().split()) == 2, 60)
            port, path = note.read_text().split()
            self._socket = connect(f"ws://127.0.0.1:{port}{path}", max_size=None, open_timeout=60).__enter__()
            self._count, self._session, self.log = itertools.count(1), None, []
            target = self.ask("Target.createTarget", url="about:blank")["targetId"]
            self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.ask(f"{domain}.enable")
            self.ask(
                "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False
            )
        except BaseException:
            self._process.kill()
            raise

    def ask(self, method, **values):
        number = next(self._count)
        message = {"id": number, "method": method, "params": values}
        if self._session:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self.log.append(answer)

    def run(self, script):
        """What a line of JavaScript gives."""
        answer = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def open(self, address):
        self.ask("Page.navigate", url=address)

    def picture(self):
        """PNG of what the tab shows."""
        return base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"])

    def mouse(self, kind, x, y, **more):
        self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start, end, steps=6):
        self.mouse("mouseMoved", *start)
        self.mouse("mousePressed", *start, button="left", buttons=1, clickCount=1)
        for step in range(1, steps + 1):
            x, y = (a + (b - a) * step / steps for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, button="left", buttons=1)
            time.sleep(0.02)
        self.mouse("mouseReleased", *end, button="left", buttons=0, clickCount=1)

    def press(self, key, text=None):
        code = ord(key.upper()) if len(key) == 1 else 9
        more = {"text": text} if text else {}
        self.ask("Input.dispatchKeyEvent", type="keyDown", key=key, windowsVirtualKeyCode=code, **more)
        self.ask("Input.dispatchKeyEvent", type="keyUp", key=key, windowsVirtualKeyCode=code)

    @property
    def faults(self):
        """What the page complains of: errors of scripts and refused resources."""
        kinds = ("Runtime.exceptionThrown", "Log.entryAdded")
        return [entry["params"] for entry in self.log if entry.get("method") in kinds]

    def close(self):
        try:
            self._session = None
            self.ask("Browser.close")
            self._socket.close()
            self._process.wait(20)
        except Exception:
            self._process.kill()
            self._process.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


def until(condition, seconds=30):
    """Wait until something is true; gives it."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "waited for too long"
        time.sleep(0.05)
    return found
