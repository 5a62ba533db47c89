"""A studio for the tests: a workspace in a temporary folder, a client that may, small logs of simulated flights."""

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient

import rotorfit.app.web.worker as worker
from flights import steps
from rotorfit.app.loopback.gate import Gate, cookie_name
from rotorfit.app.web.routes import Studio
from rotorfit.app.web.workspace import Workspace
from rotorfit.core.errors import RotorfitError
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight, write_bag

PORT, TOKEN = 8123, "a-secret-of-this-run"
HOST = f"127.0.0.1:{PORT}"
ORIGIN = f"http://{HOST}"
COOKIE = {"cookie": f"{cookie_name(PORT)}={TOKEN}"}
PAGE = {**COOKIE, "origin": ORIGIN, "sec-fetch-site": "same-origin"}
"""What a browser sends from the studio's own page."""


@contextmanager
def opened(folder: Path) -> Iterator[Studio]:
    """A studio on a folder; whatever runs is ended with it."""
    workspace = Workspace(folder)
    studio = Studio(workspace, lambda app: Gate(app, TOKEN, PORT))
    try:
        yield studio
    finally:
        studio.close()
        settled(studio)
        workspace.close()


def client_of(studio: Studio, headers: dict[str, str] | None = None) -> TestClient:
    """A client with the headers of the studio's own page, or others."""
    return TestClient(studio.app, base_url=ORIGIN, headers=PAGE if headers is None else headers)


@cache
def bag(seed: int, duration: float = 20.0) -> bytes:
    """A log of a simulated flight that the card `rotorfit-demo` fits."""
    with TemporaryDirectory() as folder:
        write_bag(simulate_flight(Truth(), steps(("x", "y"), 0.15, seed), duration, seed), Path(folder) / "log.bag")
        return (Path(folder) / "log.bag").read_bytes()


def added(client: TestClient, name: str = "flight.bag", content: bytes | None = None) -> str:
    """Id of a log that was uploaded."""
    answer = client.post("/api/logs", params={"name": name}, content=bag(1) if content is None else content)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def session_of(client: TestClient) -> dict[str, Any]:
    found: dict[str, Any] = client.get("/api/session").json()
    return found


class FitHere:
    """In the place of the process of a fit: it does the same in this one, which has imported and compiled all of it.

    It can be neither cancelled nor killed, and tells no progress.
    """

    def __init__(self, words: list[str], **_: Any) -> None:
        self._workspace, self._fit = words[-2:]
        self.pid, self.stdin, self.stdout = os.getpid(), StringIO(), self._lines()

    def _lines(self) -> Iterator[str]:
        folder = Path.cwd()
        try:
            yield json.dumps({"done": worker.run(Path(self._workspace), self._fit, lambda _fraction, _text: None)})
        except RotorfitError as error:
            yield json.dumps({"error": " ".join(str(error).split())})
        finally:
            os.chdir(folder)

    def wait(self) -> int:
        return 0  # which of the two it was is in the line


def fits_here(patch: pytest.MonkeyPatch) -> None:
    """Lets fits be made in this process from now on; `test_studio_browser.py` makes them in processes."""
    patch.setattr("rotorfit.app.web.runner.subprocess", SimpleNamespace(Popen=FitHere, PIPE=None))


def settled(studio: Studio, seconds: float = 300.0) -> None:
    """Waits until nothing runs."""
    end = time.monotonic() + seconds
    while studio.runner.running is not None:
        assert time.monotonic() < end, "the fit does not end"
        time.sleep(0.05)
