"""A studio of its own for each test that asks for one, and a browser for each module."""

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


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """A Chromium without a window."""
    from playwright.sync_api import sync_playwright
    from test_studio_browser import CHROMIUM, FLAGS

    with sync_playwright() as playwright:
        one = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield one
        one.close()
