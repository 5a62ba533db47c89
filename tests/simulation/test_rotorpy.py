"""The flight room against rotorpy, an independent simulator: our simulator does not grade itself."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[2] / "bench"


@pytest.fixture
def flights(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    pytest.importorskip("rotorpy", reason="rotorpy is not installed: pip install rotorpy")
    monkeypatch.syspath_prepend(str(BENCH))
    yield importlib.import_module("rotorpy_flights")  # type: ignore[misc]
    sys.modules.pop("rotorpy_flights", None)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crazyflie", "hummingbird"])
def test_a_small_step_of_rotorpy_becomes_that_of_the_room_the_oftener_its_loops_look(
    flights: ModuleType, name: str
) -> None:
    coarse, fine = (flights.step_gap(name, step) for step in (0.002, 0.0005))

    assert fine < 0.002
    assert fine < coarse / 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crazyflie", "hummingbird"])
def test_both_simulators_give_the_same_coefficients_within_their_intervals(flights: ModuleType, name: str) -> None:
    pair = flights.fly_both(name, 30.0)

    reach = np.ptp(pair.theirs, axis=0)
    assert (reach > 0.4).all()
    assert (np.abs(pair.theirs - pair.ours.true_position).max(axis=0) < 0.06 * reach).all()
    ours, theirs = pair.found
    for axis in flights.AXES:
        for what in ("input", "damping", "delay"):
            error = np.hypot(*(np.diff(found[axis].ci95_flight[what]) / 3.92 for found in pair.found))
            gap = getattr(theirs[axis].predictor, what) - getattr(ours[axis].predictor, what)
            assert abs(gap) < 3 * error, (axis, what)  # 18 comparisons: 1 in 20 runs would pass 3 by chance
        lags = [found[axis].combinations["total_lag"].value for found in pair.found]
        assert lags[0] == pytest.approx(lags[1], rel=0.02)
