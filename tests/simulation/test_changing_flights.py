"""The flights of the tracker's benches: closed loops as `plan_control` flies them, the truth beside what was seen."""

import importlib
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[2] / "bench"


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCH))
    yield importlib.import_module("changing_flights")  # type: ignore[misc]
    sys.modules.pop("changing_flights", None)


@pytest.mark.parametrize("cause", ["limits", "frame"])
def test_the_compiled_loop_commands_what_plan_control_commands(bench: ModuleType, cause: str) -> None:
    scenario = bench.Scenario(cause, "tello", gusts=1.0, duration=8.0, time=4.0, axes=("x", "yaw"))

    compiled = bench.changing_flight(2, scenario).room.command
    np.testing.assert_allclose(compiled, bench.by_plan_control(2, scenario), atol=1e-11)


def test_the_truth_is_at_the_flights_poses(bench: ModuleType) -> None:
    told = bench.changing_flight(3, bench.Scenario("picked_up", gusts=3.0, mean=2.0, duration=30.0, time=10.0))

    time = told.flight.pose_time
    assert told.wind.shape == told.velocity.shape == (time.size, 3)
    moved = np.interp(time, told.room.true_instant * 1e-9, told.room.true_position[:, 0])
    assert told.flight.position[:, 0] == pytest.approx(moved, abs=0.004)
    assert np.hypot(*told.wind[:, :2].mean(axis=0)) == pytest.approx(2.0, abs=1.5)
    assert told.change == 10.0
    before, after = (np.array(linear.gamma) for linear in told.linear)
    assert after[1] == pytest.approx(before[1] / 1.15)
    assert after[0] == before[0]


def test_every_cause_gives_a_flight_in_either_loop_and_only_causes_change_it(bench: ModuleType) -> None:
    plain = bench.changing_flight(4, bench.Scenario(loop="open", duration=8.0, time=4.0))
    for cause in bench.CAUSES:
        told = bench.changing_flight(4, bench.Scenario(cause, loop="open", duration=8.0, time=4.0))
        differs = (told.room.pose != plain.room.pose).any(axis=1)
        assert differs.any() == (cause != "none")
        if cause != "limits":  # that vehicle has a smaller limit from the start on
            assert not differs[told.room.true_instant < 4e9].any()


def test_a_rest_has_no_excitation(bench: ModuleType) -> None:
    told = bench.changing_flight(5, bench.Scenario(loop="open", duration=8.0, rest=(2.0, 5.0)))

    rests = (told.room.command == 0).all(axis=1)
    time = told.room.command_stamp * 1e-9
    np.testing.assert_array_equal(rests, (time >= 2.0) & (time < 5.0))
