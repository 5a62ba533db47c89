"""What the tests share."""

import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("rotorfit", deadline=None)  # a busy machine is no failure
settings.load_profile("rotorfit")

REAL_FLIGHTS = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def real_flights() -> Path:
    """Folder of the real flights; the test is skipped, saying so, where it is absent."""
    if not REAL_FLIGHTS.is_dir():
        pytest.skip(f"real flights are not there: {os.path.relpath(REAL_FLIGHTS)}")
    return REAL_FLIGHTS


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collects the tests without a search for garbage: all that is made stays, and to search it took a third of it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(10_000, 10, 10)  # tests make much that is gone at once
        gc.enable()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compiles once what nearly all tests need, before the processes that share them out each do it for themselves."""
    if session.config.getoption("numprocesses", None) and not hasattr(session.config, "workerinput"):
        from rotorfit.app import first_use

        first_use.PATIENCE = 900.0  # what a busy machine left to them, they would compile one by one
        first_use.compile_beforehand(first_use.TRACKING)
