"""A studio of its own for each test that asks for one."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
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
