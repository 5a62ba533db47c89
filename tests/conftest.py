"""What the tests share."""

import os
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent / "fakes"))  # fake vehicles, which also run as programs of their own

REAL_FLIGHTS = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def real_flights() -> Path:
    """Folder of the real flights; the test is skipped, saying so, where it is absent."""
    if not REAL_FLIGHTS.is_dir():
        pytest.skip(f"real flights are not there: {os.path.relpath(REAL_FLIGHTS)}")
    return REAL_FLIGHTS
