"""The profile: held and re-maximised, intervals, coverage."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.stats import binom

from flights import flown, recorded, steps
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.axis_estimate import estimate_axis
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.likelihood import degrees_of_freedom, inverted, score
from rotorfit.estimation.likelihood.profile import _crossing, _first_step, height, hold, profile, quantile
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight

INDEX = {"input": 0, "damping": 1, "delay": 2}


@cache
def climbed(axis: str = "z", duration: float = 30.0, seed: int = 1) -> tuple[Sequence[Record], Optimum]:
    estimate = estimate_axis([flown(Truth(), steps(seed=seed), duration, seed)], axis, True)
    return estimate.records, estimate.optimum


@pytest.mark.parametrize("name", INDEX)
def test_holding_a_parameter_where_it_is_loses_nothing_and_elsewhere_something(name: str) -> None:
    records, optimum = climbed()
    index, value = INDEX[name], optimum.point.flat()[INDEX[name]]
    error = np.sqrt(optimum.inverse[index, index])

    assert abs(height(hold(records, optimum, index, value)) - height(optimum)) < 0.01
    for side in (-1, 1):
        near, far = (height(optimum) - height(hold(records, optimum, index, value + side * k * error)) for k in (1, 3))
        assert 0.2 < near < 1.0
        assert 2.0 < far < 10.0


def test_a_held_parameter_stays_and_the_others_are_at_their_top() -> None:
    records, optimum = climbed()

    held = hold(records, optimum, 2, 0.17)
    assert held.point.delay[0] == 0.17
    assert held.gain < 0.1  # what is left is added to the height, not walked
    again = hold(records, held, 2, 0.17)
    assert abs(height(again) - height(held)) < 0.02


def test_holding_leaves_the_optimum_as_it_was() -> None:
    records, optimum = climbed()
    before = {name: np.copy(getattr(optimum, name)) for name in ("free", "inverse")} | {"flat": optimum.point.flat()}

    hold(records, optimum, 2, 0.2)
    np.testing.assert_array_equal(optimum.free, before["free"])
    np.testing.assert_array_equal(optimum.inverse, before["inverse"])
    np.testing.assert_array_equal(optimum.point.flat(), before["flat"])


@pytest.mark.parametrize("name", INDEX)
@pytest.mark.parametrize("axis", ["z", "yaw"])
def test_the_ends_of_the_interval_lie_where_the_objective_has_fallen_by_half_the_squared_quantile(
    axis: str, name: str
) -> None:
    records, optimum = climbed(axis)
    index = INDEX[name]
    direction = np.eye(optimum.point.n)[index]
    reach = quantile(optimum, direction)

    found = profile(records, optimum, index)
    assert found.fall == pytest.approx(0.5 * reach**2)
    for end in found.ci95:
        assert end is not None
        fall = height(optimum) - height(hold(records, optimum, index, end))
        assert np.sqrt(2 * fall) == pytest.approx(reach, abs=0.06)
    low, high = found.ci95
    assert low is not None
    assert high is not None
    assert low < optimum.point.flat()[index] < high


def test_where_the_likelihood_is_quadratic_the_interval_is_that_of_the_standard_error() -> None:
    records, optimum = climbed("yaw", 60.0)
    index = INDEX["input"]
    error = np.sqrt(np.linalg.inv(optimum.score.information[: optimum.point.n, : optimum.point.n])[0, 0])

    low, high = profile(records, optimum, index).ci95
    assert low is not None
    assert high is not None
    reach = quantile(optimum, np.eye(optimum.point.n)[0])
    assert (high - low) / (2 * reach * error) == pytest.approx(1.0, abs=0.05)


def test_the_points_of_a_profile_are_in_order_and_highest_at_the_estimate() -> None:
    records, optimum = climbed()

    points = profile(records, optimum, 2).points
    assert [x for x, _ in points] == sorted(x for x, _ in points)
    assert max(y for _, y in points) == 0.0
    assert (float(optimum.point.delay[0]), 0.0) in points


def test_an_end_that_the_range_cuts_off_is_open() -> None:
    """Slow sines of small amplitude: the delay is hardly known, its interval reaches beyond the range."""
    flight = flown(Truth(), partial(two_sines, axes=("z",), amplitude=0.5), 40.0, 3)
    estimate = estimate_axis([flight], "z", True)
    low, high = profile(estimate.records, estimate.optimum, 2).ci95

    assert low is None or high is None
    bound = DELAY_RANGE[0] if low is None else DELAY_RANGE[1]
    held = hold(estimate.records, estimate.optimum, 2, bound)
    assert height(estimate.optimum) - height(held) < 2.0


def test_quantiles_are_students_and_never_below_the_normal() -> None:
    _, optimum = climbed()

    for i in range(optimum.point.n):
        assert 1.959 < quantile(optimum, np.eye(optimum.point.n)[i]) < 3.2


@pytest.mark.parametrize("duration", [30.0, 150.0])
def test_degrees_of_freedom_are_those_at_the_optimum_wherever_the_climb_began(duration: float) -> None:
    """The slopes of the information must be of the same information: a reference elsewhere makes 3 out of 66."""
    flight = flown(Truth(), partial(two_sines, axes=("x",)), duration, 5)
    estimate = estimate_axis([flight], "x", True)
    own = maximise(estimate.records, estimate.optimum.point, estimate.optimum.free)

    for i in range(3):
        direction = np.eye(own.point.n)[i]
        found, expected = (degrees_of_freedom(o.score, o.free, direction) for o in (estimate.optimum, own))
        assert found == pytest.approx(expected, rel=0.1)


def test_the_slopes_behind_the_degrees_of_freedom_are_those_of_the_variance() -> None:
    records, optimum = climbed()
    score_, n = optimum.score, optimum.point.n
    C = inverted(score_.information[:n, :n], optimum.free[:n])

    for i in range(3):
        along = C[:, i]
        found = -np.einsum("i,kij,j->k", along, score_.slopes, along) / along[i]
        for k in range(4):
            logs = []
            for sign in (1.0, -1.0):
                step = np.zeros(optimum.point.flat().size)
                step[n + k] = sign * 1e-3
                moved = score(records, optimum.point.with_flat(optimum.point.flat() + step))
                logs.append(np.log(inverted(moved.information[:n, :n], optimum.free[:n])[i, i]))
            assert found[k] == pytest.approx((logs[0] - logs[1]) / 2e-3, abs=0.05)


# Coverage


def inside(truth: float, ends: tuple[float | None, float | None]) -> bool:
    low, high = ends
    return (low is None or low <= truth) and (high is None or truth <= high)


COEFFICIENTS = ("input", "damping", "delay")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["steps", "demo"])
def test_the_intervals_hold_the_truth_95_times_of_100(kind: str) -> None:
    """Counts within what a binomial of 95 % allows at 1 in 1000, per coefficient; nulls on excited axes are misses."""
    runs, hits, published = 120, dict.fromkeys(((a, c) for a in ("z", "yaw") for c in COEFFICIENTS), 0), 0
    truth = Truth()
    for seed in range(1000, 1000 + runs):
        for axis, k in (("z", 2), ("yaw", 3)):
            amplitude = 3.0 if axis == "z" else 1.0
            commands = (
                steps((axis,), seed=seed) if kind == "steps" else partial(two_sines, axes=(axis,), amplitude=amplitude)
            )
            known = fit([flown(truth, commands, 60.0, seed)], axes=(axis,), structure="first_order_delay").model.axes[
                axis
            ]
            values = (truth.gamma[2 * k], truth.gamma[2 * k + 1], truth.delay[k])
            published += known.input is not None
            for name, value in zip(COEFFICIENTS, values, strict=True):
                hits[axis, name] += known.predictor is not None and inside(value, known.ci95_flight[name])
    print(kind, hits, published)
    low, high = binom.ppf([0.0005, 0.9995], runs, 0.95)
    assert all(low <= count <= high for count in hits.values()), hits
    assert published == 2 * runs


@pytest.mark.slow
def test_the_intervals_of_x_and_y_of_the_demo_hold_the_truth_95_times_of_100() -> None:
    runs, hits = 100, dict.fromkeys(((a, c) for a in ("x", "y") for c in COEFFICIENTS), 0)
    truth = Truth()
    for seed in range(2000, 2000 + runs):
        flight = recorded(simulate_flight(truth, partial(two_sines, axes=("x", "y")), 100.0, seed))
        axes = fit([flight], axes=("x", "y"), structure="first_order_delay").model.axes
        for k, axis in enumerate(("x", "y")):
            values = (truth.gamma[2 * k], truth.gamma[2 * k + 1], truth.delay[k])
            for name, value in zip(COEFFICIENTS, values, strict=True):
                hits[axis, name] += inside(value, axes[axis].ci95_flight[name])
    print(hits)
    low, high = binom.ppf([0.0005, 0.9995], runs, 0.95)
    assert all(low <= count <= high for count in hits.values()), hits


def test_the_interval_of_a_gain_near_zero_is_reached_in_few_steps() -> None:
    _, optimum = climbed()

    for gain in (1e-12, -0.3, 1.5):
        first = _first_step(replace(optimum.point, gain=np.array([gain])), INDEX["input"], 2.0)
        assert 4.0**6 * first > 2.0 >= first


@pytest.mark.parametrize("edge", [0.7, 1.3, 2.9])
def test_an_end_where_the_fall_is_flat_beyond_is_found_and_not_the_last_number_that_was_tried(edge: float) -> None:
    def root(target: float) -> float:
        return 2.0 if target > edge else 0.5 * target / edge

    assert _crossing(root, lambda _inside, _outside: True, 0.0, 8.3, 9.2, 1.96) == pytest.approx(edge, rel=0.1)
    assert _crossing(root, lambda _inside, _outside: False, 0.0, 8.3, 9.2, 1.96) is None


def test_a_leap_to_another_maximum_does_not_end_the_way_to_the_true_end() -> None:
    walked = False

    def root(target: float) -> float:
        return 0.5 * target if walked or target < 1.0 else 4.0  # beyond 1 a leap ends on a lower maximum

    def holds(_inside: float, outside: float) -> bool:
        nonlocal walked
        walked = True
        return root(outside) > 1.96

    assert _crossing(root, holds, 0.0, 2.0, 100.0, 1.96) == pytest.approx(3.92, rel=0.03)
