"""A page in headless Chromium, driven through its debugging pipe: what a person would see, and everything that the page did meanwhile."""

from __future__ import annotations

import base64
import fcntl
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

FLAGS = (
    "--headless",
    "--no-sandbox",  # the tests may run as root, for whom Chromium has no sandbox
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
)
PATIENCE = 60.0  # [s] for one page; a loaded machine needs a few seconds


class BrowserError(Exception):
    """Chromium refused a command or ended."""


def chromium() -> str | None:
    """Where Chromium is, if it is."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@dataclass
class Page:
    """One tab. `requests` holds every address that it asked for, `complaints` what its console said."""

    commands: int
    answers: Iterator[dict[str, Any]]
    session: str | None = None
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    _numbers: Iterator[int] = field(default_factory=itertools.count)

    def call(self, method: str, **arguments: object) -> dict[str, Any]:
        """Send one command of the DevTools protocol and wait for its answer; events that come in between are kept."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": arguments} | ({"sessionId": self.session} if self.session else {})
        os.write(self.commands, json.dumps(message).encode() + b"\0")
        for answer in self.answers:
            if answer.get("id") == number:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            self._note(answer)
        raise BrowserError(f"Chromium ended before it answered {method}")

    def wait_for(self, event: str) -> None:
        """Wait until an event of this name arrives."""
        for answer in self.answers:
            self._note(answer)
            if answer.get("method") == event:
                return
        raise BrowserError(f"Chromium ended before {event}")

    def open(self, address: str) -> None:
        """Load `address` and wait until it has loaded."""
        self.call("Page.navigate", url=address)
        self.wait_for("Page.loadEventFired")

    def text(self) -> str:
        """The text that is visible on the page."""
        return self.evaluate("document.body.innerText")

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in answer:
            raise BrowserError(f"{expression}: {answer['exceptionDetails']['text']}")
        return answer["result"].get("value")

    def screenshot(self, path: Path, width: int = 1000, dark: bool = False, printed: bool = False) -> Path:
        """A picture of the whole page, from top to bottom, as PNG."""
        self.call(
            "Emulation.setEmulatedMedia",
            media="print" if printed else "screen",
            features=[{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}],
        )
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=False)
        height = int(self.evaluate("document.documentElement.scrollHeight"))
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=min(height, 16000), deviceScaleFactor=1, mobile=False)
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))
        return path

    def _note(self, event: dict[str, Any]) -> None:
        details = event.get("params", {})
        match event.get("method"):
            case "Network.requestWillBeSent":
                self.requests.append(details["request"]["url"])
            case "Runtime.consoleAPICalled" if details["type"] in ("error", "warning", "assert"):
                self.complaints.append(str([argument.get("value", argument.get("description")) for argument in details["args"]]))
            case "Runtime.exceptionThrown":
                self.complaints.append(details["exceptionDetails"]["text"])
            case "Log.entryAdded" if details["entry"]["level"] in ("error", "warning"):
                self.complaints.append(details["entry"]["text"])


@contextmanager
def page() -> Iterator[Page]:
    """A fresh browser with a fresh profile and one empty tab; it is gone afterwards, whatever happened."""
    program, bash = chromium(), shutil.which("bash")
    if program is None or bash is None:
        raise BrowserError("there is no Chromium here: the package is called chromium")
    with tempfile.TemporaryDirectory(prefix="slewcert-browser-", ignore_cleanup_errors=True) as profile:
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()
        # Chromium listens on 3 and answers on 4: numbers of our own are kept above, so that the shell can put them there in any order
        theirs = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (theirs_in, theirs_out)]
        script = f'exec "$@" 3<&{theirs[0]} 4>&{theirs[1]}'
        flags = (*FLAGS, "--remote-debugging-pipe", f"--user-data-dir={profile}", "about:blank")
        with tempfile.TemporaryFile() as noise:
            process = subprocess.Popen(
                [bash, "-c", script, "bash", program, *flags],
                pass_fds=theirs,
                stdin=subprocess.DEVNULL,
                stdout=noise,
                stderr=noise,
                start_new_session=True,
            )
            for end in (theirs_in, theirs_out, *theirs):
                os.close(end)
            deadline = threading.Timer(PATIENCE, _end, [process])
            deadline.start()
            try:
                tab = Page(ours_out, _messages(ours_in))
                target = tab.call("Target.createTarget", url="about:blank")["targetId"]
                tab.session = tab.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
                for domain in ("Page", "Network", "Runtime", "Log"):
                    tab.call(f"{domain}.enable")
                yield tab
            finally:
                deadline.cancel()
                _end(process)
                process.wait()
                os.close(ours_in)
                os.close(ours_out)


def look_at(file: Path, pictures: Path) -> dict[str, Any]:
    """What a person sees of a page, light and dark, printed and on a telephone: text, requests, complaints, measures and pictures."""
    with page() as tab:
        tab.open(file.as_uri())
        found = {
            "address": file.as_uri(),
            "text": tab.text(),
            "title": tab.evaluate("document.title"),
            "plots": tab.evaluate(
                "[...document.querySelectorAll('svg')].map(s => [s.getBoundingClientRect().width, s.getBoundingClientRect().height])"
            ),
            "pictures": [
                tab.screenshot(pictures / f"{file.stem}.png"),
                tab.screenshot(pictures / f"{file.stem}-dark.png", dark=True),
                tab.screenshot(pictures / f"{file.stem}-print.png", printed=True),
                tab.screenshot(pictures / f"{file.stem}-narrow.png", width=390),
            ],
            "narrow_overflow": tab.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth"),
        }
        found |= {"requests": tuple(tab.requests), "complaints": tuple(tab.complaints)}
    print("\n".join(map(str, found["pictures"])))
    return found


def _messages(source: int) -> Iterator[dict[str, Any]]:
    rest = b""
    while piece := os.read(source, 1 << 16):
        *whole, rest = (rest + piece).split(b"\0")
        yield from map(json.loads, whole)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the browser and the processes that it started: they are a group of their own."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
