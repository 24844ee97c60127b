"""A browser without a window, driven by the WebDriver protocol through ``chromedriver``; no library."""

import base64
import json
import shutil
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any, Self

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--force-color-profile=srgb",
    "--hide-scrollbars",
)


def missing() -> str:
    """What is not installed, in words; nothing if a browser can be driven."""
    if not shutil.which("chromedriver"):
        return "chromedriver is not installed"
    return "" if any(map(shutil.which, BROWSERS)) else "Chromium is not installed"


class Browser:
    """One window; close it by leaving the ``with`` block."""

    def __init__(self, width: int = 1000, height: int = 800, *flags: str):
        self._driver = subprocess.Popen(
            ["chromedriver", "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        said = next(line for line in self._driver.stdout if "successfully on port" in line)
        self._address = f"http://127.0.0.1:{int(said.rstrip().rstrip('.').rpartition(' ')[2])}"
        options = {
            "binary": next(filter(None, map(shutil.which, BROWSERS))),
            "args": [*FLAGS, f"--window-size={width},{height}", *flags],
        }
        wanted = {"goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL", "performance": "ALL"}}
        self._session = ""
        try:
            made = self._ask("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        except BaseException:
            self._driver.kill()
            raise
        self._session = f"/session/{made['sessionId']}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._ask("DELETE", "")
        finally:
            self._driver.kill()
            self._driver.wait()

    def _ask(self, method: str, path: str, body: dict | None = None) -> Any:
        content = None if method != "POST" else json.dumps(body or {}).encode()
        request = urllib.request.Request(f"{self._address}{self._session}{path}", content, method=method)
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(json.load(error)["value"]["message"].splitlines()[0]) from error

    def open(self, address: str | Path) -> None:
        """Load a page and forget what was logged before."""
        self.logs("browser"), self.logs("performance")
        self._ask("POST", "/url", {"url": address.as_uri() if isinstance(address, Path) else address})

    def run(self, script: str, *arguments: Any) -> Any:
        """Run JavaScript in the page; its ``return`` comes back as JSON values."""
        return self._ask("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def keys(self, *keys: str) -> None:
        """Press keys, one after another, wherever the focus is."""
        actions = [{"type": kind, "value": key} for key in keys for kind in ("keyDown", "keyUp")]
        self._ask("POST", "/actions", {"actions": [{"type": "key", "id": "keyboard", "actions": actions}]})

    def devtools(self, command: str, **params: Any) -> Any:
        """A command of Chromium's own protocol."""
        return self._ask("POST", "/goog/cdp/execute", {"cmd": command, "params": params})

    def logs(self, kind: str) -> list[dict]:
        """What was logged since the last call: of kind "browser" (the console) or "performance" (the network too)."""
        return self._ask("POST", "/se/log", {"type": kind})

    def screenshot(self) -> bytes:
        """The window as PNG."""
        return base64.b64decode(self._ask("GET", "/screenshot"))

    def wait(self, script: str, *arguments: Any, seconds: float = 15) -> Any:
        """Ask the page again and again, until it returns something true."""
        until = time.monotonic() + seconds
        while not (value := self.run(script, *arguments)):
            if time.monotonic() > until:
                raise TimeoutError(script)
            time.sleep(0.05)
        return value
