"""What the tests share."""

import os
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


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compiles once what nearly all tests need, before the processes that share them out each do it for themselves."""
    if session.config.getoption("numprocesses", None) and not hasattr(session.config, "workerinput"):
        from rotorfit.app.first_use import TRACKING, compile_beforehand

        compile_beforehand(TRACKING)
