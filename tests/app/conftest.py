"""A studio of its own for each test that asks for one, a browser for each module, and looks without a process."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser
    from starlette.testclient import TestClient

    from rotorfit.app.web.routes import Studio


@pytest.fixture
def studio(tmp_path: Path) -> "Iterator[Studio]":
    """On an empty workspace."""
    from studio_room import opened

    with opened(tmp_path / "workspace") as one:
        yield one


@pytest.fixture
def page(studio: "Studio") -> "TestClient":
    """What its own page may ask."""
    from studio_room import client_of

    return client_of(studio)


@pytest.fixture
def looks_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracker of a link looks in this process: one beside takes a second to start, and tells the same.

    `tracking/test_looks_beside.py` proves the latter, as do the tests here that do not ask for this.
    """
    from rotorfit.tracking import tracker
    from rotorfit.tracking.following import Following
    from rotorfit.tracking.looks import LooksHere

    monkeypatch.setattr(tracker, "LooksBeside", lambda _card, _path, promised, _paced: LooksHere(Following(*promised)))


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """A Chromium without a window."""
    from playwright.sync_api import sync_playwright
    from test_studio_browser import CHROMIUM, FLAGS

    with sync_playwright() as playwright:
        one = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield one
        one.close()
