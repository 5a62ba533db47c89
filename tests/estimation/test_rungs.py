"""The rungs between the paper and the likelihood: exact without noise, laws, odd data, what they say of themselves."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flights import STILL, by_hand, flown, recorded, steps, truth_of, turned
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.methods import METHODS
from rotorfit.estimation.regression.axes_by_method import axes_by_method, estimator_of
from rotorfit.estimation.regression.instrumental_variables import COMMAND, REFERENCE, iv
from rotorfit.estimation.regression.least_squares import svf
from rotorfit.estimation.regression.result import MethodResult, axis_of_rung
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Controller, Truth, simulate_flight

pytestmark = pytest.mark.flights

REGRESSIONS = [name for name, method in METHODS.items() if method.estimator]
GROUPS = (("x", "y"), ("z",), ("yaw",))
LIMIT = 3e-4
"""Relative error of gain and damping without noise."""


@cache
def still() -> Flight:
    """15 s without wind and noise, turning all the while, held commands."""
    return flown(STILL, steps(), 15.0)


@cache
def continuous() -> Flight:
    """The same vehicle under the paper's sines, which change all the time; the log has their value at every pose."""
    return recorded(simulate_flight(STILL, two_sines, 15.0, 1, held=False))


def values(rung: MethodResult, axis: str) -> dict[str, float]:
    k = rung.axes.index(axis)
    return dict(zip(COEFFICIENTS, (rung.gain[k], rung.damping[k], rung.delay[k]), strict=True))


def only(flight: Flight, *axes: str) -> Flight:
    """The flight with the commands of these axes alone."""
    kept = [axis in axes for axis in AXES]
    return replace(flight, command=flight.command * kept, axes=axes)


# Without noise


@pytest.mark.parametrize("method", REGRESSIONS)
@pytest.mark.parametrize("group", GROUPS)
def test_without_noise_a_turning_flight_gives_its_coefficients_back(method: str, group: tuple[str, ...]) -> None:
    rung = estimator_of(method)([still()], group)

    for axis in group:
        found, truth = values(rung, axis), truth_of(STILL, axis)
        assert found["input"] == pytest.approx(truth["input"], rel=LIMIT)
        assert found["damping"] == pytest.approx(truth["damping"], rel=LIMIT)
        assert found["delay"] == pytest.approx(truth["delay"], abs=1e-4)


@pytest.mark.parametrize("method", REGRESSIONS)
def test_commands_that_change_all_the_time_are_taken_as_held_which_shortens_the_delay_by_half_a_period(
    method: str,
) -> None:
    rung = estimator_of(method)([continuous()], ("x", "y"))

    for axis in ("x", "y"):
        found, truth = values(rung, axis), truth_of(STILL, axis)
        assert found["input"] == pytest.approx(truth["input"], rel=LIMIT)
        assert found["damping"] == pytest.approx(truth["damping"], rel=LIMIT)
        assert found["delay"] == pytest.approx(truth["delay"] - 0.5 / STILL.pose_rate, abs=1e-4)


@pytest.mark.parametrize("method", REGRESSIONS)
def test_a_trim_does_not_bias(method: str) -> None:
    truth = replace(STILL, trim=(0.1, -0.1, 0.2, 0.0))
    rung = estimator_of(method)([flown(truth, steps(("z",)), 15.0)], ("z",))

    assert values(rung, "z")["damping"] == pytest.approx(truth_of(truth, "z")["damping"], rel=LIMIT)
    assert rung.trim[0, 0] == pytest.approx(0.2, rel=1e-3)


# Laws


@pytest.mark.parametrize("method", REGRESSIONS)
def test_turning_the_world_turns_nothing(method: str) -> None:
    one, two = (estimator_of(method)([flight], ("x", "y")) for flight in (still(), turned(still(), 2.0)))

    np.testing.assert_allclose(one.gain, two.gain, rtol=1e-4)
    np.testing.assert_allclose(one.damping, two.damping, rtol=3e-4)
    np.testing.assert_allclose(one.delay, two.delay, atol=2e-4)


@pytest.mark.parametrize("method", REGRESSIONS)
def test_scaling_the_commands_scales_the_gain_and_shifting_a_clock_shifts_the_delay(method: str) -> None:
    flight = still()
    other = replace(flight, command=4.0 * flight.command, command_time=flight.command_time - 0.05)
    other = replace(other, segments=tuple(Segment(s.start - 0.05, s.end - 0.05) for s in flight.segments))
    one, two = (values(estimator_of(method)([f], ("z",)), "z") for f in (flight, other))

    assert 4 * two["input"] == pytest.approx(one["input"], rel=LIMIT)
    assert two["damping"] == pytest.approx(one["damping"], rel=LIMIT)
    assert two["delay"] == pytest.approx(one["delay"] + 0.05, abs=2e-4)


@pytest.mark.parametrize("method", REGRESSIONS)
def test_several_flights_segments_holes_and_slow_jittered_poses_are_no_obstacle(method: str) -> None:
    flight = flown(STILL, steps(("z",)), 20.0, seed=3)
    rng = np.random.default_rng(3)
    keep = (rng.random(flight.pose_time.size) < 0.4) & ~((flight.pose_time > 6) & (flight.pose_time < 6.7))
    ragged = replace(
        flight,
        pose_time=flight.pose_time[keep],
        position=flight.position[keep],
        yaw=flight.yaw[keep],
        segments=(Segment(0.0, 12.0), Segment(float(flight.command_time[650]), flight.segments[-1].end)),
    )
    rung = estimator_of(method)([ragged, only(still(), "z")], ("z",))

    found, truth = values(rung, "z"), truth_of(STILL, "z")
    assert found["input"] == pytest.approx(truth["input"], rel=2e-3)
    assert found["damping"] == pytest.approx(truth["damping"], rel=2e-3)
    assert found["delay"] == pytest.approx(truth["delay"], abs=2e-4)
    assert rung.trim.shape == (2, 1)


@pytest.mark.parametrize("method", REGRESSIONS)
def test_an_axis_that_nobody_commands_is_no_obstacle_to_the_other_and_has_no_number(method: str) -> None:
    rung = estimator_of(method)([flown(STILL, steps(("x", "yaw")), 15.0)], ("x", "y"))

    assert values(rung, "x")["input"] == pytest.approx(truth_of(STILL, "x")["input"], rel=LIMIT)
    assert rung.failed["y"][0] == "not_excited"


# What is said


@pytest.mark.parametrize("method", REGRESSIONS)
def test_a_short_flight_is_told_from_one_that_is_not_excited(method: str) -> None:
    short, idle = flown(STILL, steps(), 4.0), only(flown(Truth(), steps(), 20.0), "x")

    for flight, status in ((short, "too_short"), (idle, "not_excited")):
        axis, reason = axis_of_rung(estimator_of(method)([flight], ("z",)), "z")
        assert set(axis.status.values()) == {status}
        assert (axis.input, axis.damping, axis.delay, axis.predictor) == (None,) * 4
        assert reason


@pytest.mark.parametrize("method", REGRESSIONS)
def test_a_command_that_never_changes_gives_no_delay(method: str) -> None:
    constant = flown(Truth(), lambda t: np.full((t.size, 4), 0.1), 12.0)
    axis, reason = axis_of_rung(estimator_of(method)([constant], ("z",)), "z")

    assert axis.delay is None
    assert reason


@pytest.mark.parametrize("method", REGRESSIONS)
def test_commands_that_the_vehicle_never_got_are_never_a_confident_model(method: str) -> None:
    flight = flown(Truth(), steps(("z",)), 40.0, seed=4)
    other = replace(flight, command=steps(("z",), seed=99)(flight.command_time))
    axis, _ = axis_of_rung(estimator_of(method)([other], ("z",)), "z")

    numbers = [value for value in (axis.input, axis.damping, axis.delay) if value is not None]
    assert len(numbers) < 3 or abs(axis.input or 0) < 0.3 * truth_of(Truth(), "z")["input"]
    assert all(abs(value) < 100 for value in numbers)


@pytest.mark.parametrize("method", REGRESSIONS)
@pytest.mark.parametrize("pose", ["standing", "line", "noise", "far"])
def test_no_rung_raises_on_odd_motion_nor_prints_what_is_no_number(method: str, pose: str) -> None:
    rng = np.random.default_rng(8)
    time = np.arange(0, 6.0, 0.02)
    motion = {
        "standing": np.zeros((time.size, 4)),
        "line": time[:, None] * [1.0, 2.0, 3.0, 0.1],
        "noise": rng.normal(size=(time.size, 4)),
        "far": 1e6 + rng.normal(size=(time.size, 4)).cumsum(axis=0),
    }[pose]
    flight = by_hand(time, motion, time[::2], rng.normal(size=(time.size // 2, 4)))

    for group in GROUPS:
        rung = estimator_of(method)([flight], group)
        for name in group:
            axis, _ = axis_of_rung(rung, name)
            numbers = [axis.input, axis.damping, axis.delay, *axis.stderr.values()]
            assert all(value is None or np.isfinite(value) for value in numbers)


@pytest.mark.parametrize("method", REGRESSIONS)
def test_without_a_flight_there_is_nothing_to_tell(method: str) -> None:
    assert estimator_of(method)([], ("z",)).failed["z"][0] == "too_short"


# Instruments


@cache
def loop() -> Flight:
    """60 s of z in a tight feedback loop in wind; the reference is what was added to the controller's commands."""
    truth, excitation = replace(Truth(), wind_sigma=(0.0, 0.0, 0.1, 0.0)), steps(("z",))
    flight = flown(truth, excitation, 60.0, 6, controller=Controller(3.0, 3.0))
    return replace(flight, reference=excitation(flight.command_time))


def test_in_a_loop_least_squares_and_the_commands_as_instrument_are_biased_and_the_reference_is_not() -> None:
    truth, without = truth_of(Truth(), "z")["damping"], replace(loop(), reference=None)
    found = {}
    for name, method, flight in (("svf", svf, loop()), ("command", iv, without), ("reference", iv, loop())):
        axis, _ = axis_of_rung(method([flight], ("z",)), "z")
        assert axis.predictor
        low, high = axis.ci95["damping"]
        assert low is not None
        assert high is not None
        found[name] = (axis.predictor.damping, low, high)

    assert found["svf"][2] < truth
    assert found["command"][0] > 1.2 * truth
    assert found["reference"][1] < truth < found["reference"][2]
    assert abs(found["reference"][0] / truth - 1) < 0.1


def test_the_result_says_which_instrument_was_used() -> None:
    for flight, said in ((loop(), REFERENCE), (replace(loop(), reference=None), COMMAND)):
        assert said in axes_by_method([flight], ("z",), "iv")[2]["z"]


def test_a_reference_that_one_of_the_axes_lacks_is_not_used() -> None:
    reference = np.full((still().command_time.size, 4), np.nan)
    reference[:, 0] = still().command[:, 0]

    assert COMMAND in iv([replace(still(), reference=reference)], ("x", "y")).remark["x"]
