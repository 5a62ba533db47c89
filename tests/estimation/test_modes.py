"""Optima: what the search finds, which it believes, and that the false ones of a feedback loop are not believed."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flights import STILL, Excitation, flown, steps, truth_of, two_sines
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.model import COEFFICIENTS, Model
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.axis_estimate import free_of
from rotorfit.estimation.likelihood.blocks import BLOCK_RATE, Record, record
from rotorfit.estimation.likelihood.optima import (
    EXCERPT,
    STARTS,
    CandidateOptimum,
    dynamics_of,
    excerpt,
    is_inverse_loop,
    prediction_error,
    search,
    without_input,
)
from rotorfit.estimation.likelihood.trims import trims_of
from rotorfit.simulation.paper_vehicle import GAMMA_A, GAMMA_E, Controller, Truth

pytestmark = pytest.mark.flights


def searched(flight: Flight, axes: tuple[str, ...]) -> tuple[Sequence[Record], tuple[CandidateOptimum, ...]]:
    rec = record(flight, axes)
    assert rec is not None
    return (rec,), search((rec,), [flight], free_of([rec], [True] * len(axes)))


@cache
def open_loop(axes: tuple[str, ...]) -> tuple[Flight, Sequence[Record], tuple[CandidateOptimum, ...]]:
    flight = flown(Truth(), steps(axes), 40.0, 2)
    return flight, *searched(flight, axes)


@pytest.mark.parametrize("axes", [("z",), ("yaw",), ("x", "y")])
def test_in_open_loop_the_search_finds_the_vehicle_and_believes_it(axes: tuple[str, ...]) -> None:
    _, _, found = open_loop(axes)

    best = found[0].optimum.point
    for k, axis in enumerate(axes):
        truth = truth_of(Truth(), axis)
        assert best.gain[k] == pytest.approx(truth["input"], rel=0.05)
        assert best.delay[k] == pytest.approx(truth["delay"], abs=0.01)
        assert found[0].prediction[k] < 0.5 * found[0].held[k]
    assert sum(one.starts for one in found) == len(STARTS)
    assert found[0].starts >= 3


@pytest.mark.parametrize("pose_rate", [60.0, 70.0])
def test_without_noise_no_ledge_of_the_likelihood_is_taken_for_its_top(pose_rate: float) -> None:
    still = replace(STILL, gamma=GAMMA_A, pose_rate=pose_rate)
    _, (best, *_) = searched(flown(still, two_sines, 20.0), ("yaw",))

    assert best.optimum.point.delay[0] == pytest.approx(truth_of(still, "yaw")["delay"], abs=1e-6)
    assert best.optimum.point.gain[0] == pytest.approx(truth_of(still, "yaw")["input"], rel=1e-6)


def test_the_optima_are_told_apart_and_ordered_by_prediction_behind_the_believed_one() -> None:
    truth = replace(Truth(), wind_sigma=(0.1,) * 4)
    _, found = searched(flown(truth, steps(("z",), 0.1), 60.0, 1, controller=Controller()), ("z",))

    assert len(found) > 1
    for i, one in enumerate(found):
        for other in found[:i]:
            a, b = one.optimum.point, other.optimum.point
            assert abs(a.delay - b.delay) > 0.005 or abs(a.log_damping - b.log_damping) > 0.1
    errors = [float(one.prediction[0]) for one in found if not is_inverse_loop(one.optimum, 0)]
    assert errors[1:] == sorted(errors[1:])
    assert errors[0] <= 1.05 * min(errors)


def test_the_judging_error_grows_where_a_coefficient_is_wrong() -> None:
    flight, _, found = open_loop(("z",))
    optimum = found[0].optimum

    right, held = prediction_error([flight], ("z",), optimum)
    for change in ({"gain": 0.5 * optimum.point.gain}, {"delay": optimum.point.delay + 0.2}):
        wrong, same = prediction_error([flight], ("z",), replace(optimum, point=replace(optimum.point, **change)))
        assert wrong[0] > 1.5 * right[0]
        assert same[0] == pytest.approx(held[0], rel=0.2)  # from the same kind of start


def test_flights_too_short_to_predict_are_judged_by_nothing() -> None:
    _, _, found = open_loop(("z",))

    error, held = prediction_error([flown(Truth(), steps(), 2.5)], ("z",), found[0].optimum)
    assert np.isnan(error).all()
    assert np.isnan(held).all()


def test_without_its_input_an_axis_does_worse_and_the_other_keeps_its_coefficients() -> None:
    _, records, found = open_loop(("x", "y"))
    optimum = found[0].optimum

    idle = without_input(records, optimum, [0])
    assert idle.point.gain[0] == 0.0
    assert idle.point.gain[1] == pytest.approx(optimum.point.gain[1], rel=0.1)
    assert idle.score.log_likelihood < optimum.score.log_likelihood - 100
    assert not idle.free[[0, 2, 4]].any()


def test_an_optimum_is_judged_with_trims_as_large_as_it_may_make_them() -> None:
    flights = [flown(replace(Truth(), trim=(0.0, 0.0, trim, 0.0)), steps(("z",)), 30.0, 4) for trim in (0.05, -0.1)]
    records = [rec for f in flights if (rec := record(f, ("z",)))]
    optimum = search(records, flights, free_of(records, [True]))[0].optimum

    trim, variance = trims_of(optimum)
    np.testing.assert_allclose(trim[:, 0], [0.05, -0.1], atol=0.02)
    assert (variance < 0.02**2).all()
    assert dynamics_of(("z",), optimum)["z"].trim_variance == pytest.approx(np.mean(trim**2 + variance), rel=1e-9)


# The excerpt


def test_a_flight_of_a_minute_is_searched_whole_and_a_longer_one_where_it_is_commanded_most() -> None:
    def command(t: np.ndarray) -> np.ndarray:
        out: np.ndarray = steps(("z",))(t) * ((t > 80) & (t < 130))[:, None]
        return out

    short, long = flown(Truth(), command, 55.0), flown(Truth(), command, 180.0)

    assert excerpt(short, ("z",)) is short
    part = excerpt(long, ("z",))
    (segment,) = part.segments
    assert segment.end - segment.start == pytest.approx(EXCERPT, abs=0.1)
    assert segment.start <= 80 + 1e-6
    assert segment.end >= 130 - 1e-6
    for stamps in (part.pose_time, part.command_time):
        assert segment.start <= stamps[0] < stamps[-1] <= segment.end


def test_an_excerpt_keeps_the_holes_between_segments() -> None:
    flight = flown(Truth(), steps(("z",)), 100.0)
    parts = (Segment(0.0, 30.0), Segment(40.0, flight.segments[0].end))

    cut = excerpt(replace(flight, segments=parts), ("z",))
    assert all(any(p.start <= c.start and c.end <= p.end for p in parts) for c in cut.segments)


def test_where_commands_are_rare_the_excerpt_begins_with_one_of_its_own() -> None:
    """Which command acts at the start of a segment must be known there: its first one is at its start."""
    truth = replace(Truth(), command_rate=0.87, command_jitter=0.0)
    flight = flown(truth, lambda t: steps(("z",), every=2.0)(t) * (t > 75)[:, None], 150.0)

    part = excerpt(flight, ("z",))
    assert part.segments[0].start > 10.0
    assert part.command_time[0] <= part.segments[0].start + 1e-9


# Feedback


LIGHT, STRONG = 0.02, 0.1
"""Standard deviation of the wind [m/s^2]."""


def published_and_false(model: Model, truth: Truth, axes: Sequence[str]) -> list[str]:
    """Coefficients that are published as known with an interval that misses the truth by more than its own width."""
    false = []
    for axis in axes:
        for name in COEFFICIENTS:
            low, high = model.axes[axis].ci95[name]
            value = truth_of(truth, axis)[name]
            if model.axes[axis].status[name] != "ok" or low is None or high is None:
                continue
            width = high - low
            if not low - width < value < high + width:
                false.append(f"{axis}.{name} = {getattr(model.axes[axis], name):.4g}, not {value:.4g}")
    return false


def in_loop(wind: float, excitation: Excitation, seed: int) -> tuple[Flight, Truth]:
    truth = replace(Truth(), wind_sigma=(wind,) * 4)
    return flown(truth, excitation, 100.0, seed, controller=Controller()), truth


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("wind", [LIGHT, STRONG])
def test_in_a_feedback_loop_that_is_excited_from_outside_the_vehicle_is_found(wind: float, seed: int) -> None:
    flight, truth = in_loop(wind, steps(("x", "z"), 0.1, seed=seed), seed)
    model = fit([flight], axes=("x", "z"), structure="first_order_delay").model

    assert published_and_false(model, truth, ("x", "z")) == []
    for axis in ("x", "z"):
        assert model.axes[axis].status["input"] == model.axes[axis].status["delay"] == "ok"
        assert model.axes[axis].input == pytest.approx(truth_of(truth, axis)["input"], rel=0.1)


@pytest.mark.parametrize(
    ("wind", "amplitude", "seed"),
    [
        (LIGHT, 0.0, 2),
        (STRONG, 0.0, 1),
        (STRONG, 0.02, 4),
        # of these only a slow response to old commands is left, its delay anywhere
        (LIGHT, 0.0, 13),
        (STRONG, 0.0, 11),
        (STRONG, 0.02, 16),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in ((LIGHT, 0.0, 4), (STRONG, 0.02, 1), (STRONG, 0.02, 6))
        ),
    ],
)
def test_in_a_feedback_loop_without_much_excitation_the_controller_is_not_published_for_the_vehicle(
    wind: float, amplitude: float, seed: int
) -> None:
    """The command answers the position 50 ms before: read backwards (negative delay, damping at its bound, sign
    flipped) that explains every motion, and since a loop's future commands tell of future motion, it even predicts."""
    flight, truth = in_loop(wind, steps(("x", "z"), amplitude, seed=seed), seed)

    assert published_and_false(fit([flight], axes=("x", "z")).model, truth, ("x", "z")) == []


@pytest.mark.parametrize(("axis", "seed"), [("z", 1), ("z", 3), ("x", 1), ("x", 4)])
def test_the_mode_that_is_called_chosen_is_the_model(axis: str, seed: int) -> None:
    """Searched on a minute, climbed on the whole flight: the numbers differ by their errors, not by half a second."""
    truth = replace(Truth(), wind_sigma=(STRONG,) * 4, stale_share=0.0)
    flight = flown(truth, steps((axis,), 0.02, seed=seed), 100.0, seed, controller=Controller())

    known = fit([flight], axes=(axis,), structure="first_order_delay").model.axes[axis]
    chosen = [mode for mode in known.modes if mode.chosen]
    assert len(chosen) == 1
    if known.predictor is not None:
        assert chosen[0].delay == pytest.approx(known.predictor.delay, abs=0.08)
        assert chosen[0].input * known.predictor.input > 0


def test_the_block_rate_of_the_search_is_that_of_the_records() -> None:
    flight, records, _ = open_loop(("z",))

    assert records[0].count.size / flight.duration == pytest.approx(BLOCK_RATE, rel=0.05)


@pytest.mark.parametrize("seed", [4, pytest.param(5, marks=pytest.mark.slow)])
def test_axes_of_one_search_that_are_right_in_different_optima_are_put_together(seed: int) -> None:
    """Far apart delays of x and y in a turning flight: no start was right for both."""
    truth = replace(
        Truth(),
        gamma=GAMMA_E,
        delay=(0.28, 0.02, 0.15, 0.15),
        wind_sigma=(0.08, 0.08, 0.08, 0.03),
        mocap_noise=(1e-4,) * 4,
    )
    flight = flown(truth, steps(amplitude=(1.0, 1.0, 0.3, 0.4), seed=seed, every=1.2), 40.0, seed)
    model = fit([flight], axes=("x", "y"), structure="first_order_delay").model
    assert model.axes["x"].delay == pytest.approx(0.28, abs=0.01)
    assert model.axes["y"].delay == pytest.approx(0.02, abs=0.01)
