"""The likelihood: gradient and information against differences, the restricted part against its closed form."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize

from flights import flown, steps
from rotorfit.core.laws import DELAY_RANGE, LEVEL_RANGE
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.likelihood import (
    adjustment,
    degrees_of_freedom,
    inverted,
    level_share,
    restriction,
    score,
    segments,
    whiten,
)
from rotorfit.estimation.likelihood.parameters import DAMPING_RANGE, Point
from rotorfit.simulation.paper_vehicle import Truth

Array = np.ndarray

LEVELS = np.log(np.array([[0.02, 4e-7, 2.0, 0.5], [0.05, 2e-7, 3.0, 0.8]]))


@cache
def records_of(axes: tuple[str, ...], duration: float = 12.0) -> tuple[Record, ...]:
    """Two flights, the second with a hole of the commands in it."""
    flights = [flown(Truth(), steps(seed=seed), duration, seed, initial_yaw=0.7 * seed) for seed in (1, 2)]
    gap = flights[1]
    middle = gap.duration / 2
    outside = np.abs(gap.command_time - middle) > 0.4
    first, second = (replace(gap.segments[0], **end) for end in ({"end": middle - 0.4}, {"start": middle + 0.4}))
    gap = replace(gap, command_time=gap.command_time[outside], command=gap.command[outside], segments=(first, second))
    made = tuple(rec for flight in (flights[0], gap) if (rec := record(flight, axes)))
    assert [rec.starts.size for rec in made] == [1, 2]
    return made


def point_of(records: Sequence[Record], seed: int = 0) -> Point:
    """A point near the truth, nothing at a round number."""
    rng, K = np.random.default_rng(seed), len(records[0].axes)
    parts = sum(rec.starts.size for rec in records)
    return Point(
        gain=np.array([3.6, 3.9])[:K],
        log_damping=np.log([0.2, 0.31])[:K],
        delay=np.array([0.1437, 0.1571])[:K],
        trim=0.02 * rng.standard_normal((len(records), K)),
        start=0.05 * rng.standard_normal((parts, K)),
        levels=LEVELS[:K],
    )


GROUPS = [("z",), ("yaw",), ("x", "y")]


def differences(function: Callable[[Point], float], point: Point, indices: Sequence[int], step: float) -> Array:
    """Central differences by some of the parameters."""
    out = []
    for i in indices:
        move = np.zeros(point.flat().size)
        move[i] = step
        out.append(function(point.with_flat(point.flat() + move)) - function(point.with_flat(point.flat() - move)))
    return np.array(out) / (2 * step)


# The point


def test_a_point_survives_the_way_to_numbers_and_back() -> None:
    point = point_of(records_of(("x", "y")))
    again = point.with_flat(point.flat())

    for name in ("gain", "log_damping", "delay", "trim", "start", "levels"):
        np.testing.assert_array_equal(getattr(again, name), getattr(point, name))
    assert point.n == 6 + 4 + 6
    assert point.flat().size == point.n + 8


def test_a_move_stays_inside_the_searched_ranges() -> None:
    point = point_of(records_of(("x", "y")))
    low, high = point.bounds()

    for step, bound in ((1e9, high), (-1e9, low)):
        values = point.moved(np.full(low.size, step)).flat()
        np.testing.assert_array_equal(values[np.isfinite(bound)], bound[np.isfinite(bound)])
    np.testing.assert_allclose(low[2:6], [*np.log(DAMPING_RANGE)[[0, 0]], *np.array(DELAY_RANGE)[[0, 0]]])
    np.testing.assert_array_equal(low[-8:], np.tile(LEVEL_RANGE[:, 0], 2))


def test_the_reach_of_a_step_ends_at_the_first_bound_and_ignores_bounds_already_met() -> None:
    point = point_of(records_of(("z",)))
    step = np.zeros(point.flat().size)
    assert point.reach(step) == 1.0
    step[2] = 2 * (DELAY_RANGE[1] - point.delay[0])
    assert point.reach(step) == pytest.approx(0.5)

    at_bound = point.moved(step)
    assert at_bound.delay[0] == DELAY_RANGE[1]
    assert at_bound.reach(step) == 1.0


def test_rows_of_the_start_velocities_go_to_the_flights_in_turn() -> None:
    assert segments(records_of(("z",))) == [slice(0, 1), slice(1, 3)]


# Gradient and information of the coefficients


@pytest.mark.parametrize("axes", GROUPS)
def test_the_gradient_agrees_with_differences(axes: tuple[str, ...]) -> None:
    """To six digits of a standard error's worth, save the delay, whose differences step over switches (see below)."""
    records = records_of(axes)
    point = point_of(records)
    K, here = len(axes), score(records, point)
    smooth = [i for i in range(point.n) if not 2 * K <= i < 3 * K]

    expected = differences(lambda p: score(records, p).log_likelihood, point, smooth, 1e-5)
    unit = np.sqrt(np.diag(here.information)[smooth])
    np.testing.assert_allclose(here.gradient[smooth] / unit, expected / unit, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("axes", "tolerance"), [(("z",), 1e-5), (("x", "y"), 2e-3)])
def test_the_gradient_by_the_delay_agrees_with_differences(axes: tuple[str, ...], tolerance: float) -> None:
    """The likelihood is once differentiable in the delay. On a turning plane the heading in the middle of a step moves
    with the switch, which the sensitivity leaves out: a thousandth."""
    records = records_of(axes)
    point = point_of(records)
    K, here = len(axes), score(records, point)
    delays = list(range(2 * K, 3 * K))

    expected = differences(lambda p: score(records, p).log_likelihood, point, delays, 1e-7)
    np.testing.assert_allclose(here.gradient[delays], expected, rtol=tolerance)


@pytest.mark.parametrize("axes", GROUPS)
def test_the_information_is_that_of_the_differences_of_the_innovations(axes: tuple[str, ...]) -> None:
    records = records_of(axes)
    point = point_of(records)
    n = point.n

    slopes = []
    for i in range(n):
        ends = []
        for sign in (1.0, -1.0):
            move = np.zeros(point.flat().size)
            move[i] = sign * 1e-6
            innovations = score(records, point.with_flat(point.flat() + move)).innovations
            ends.append(np.concatenate([e.ravel() for e in innovations]))
        slopes.append((ends[0] - ends[1]) / 2e-6)
    J = np.array(slopes)
    here = score(records, point).information[:n, :n]
    unit = np.sqrt(np.outer(np.diag(here), np.diag(here)))
    np.testing.assert_allclose(J @ J.T / unit, here / unit, rtol=0, atol=2e-3)


def test_flights_and_segments_add_up_and_share_only_the_coefficients() -> None:
    records = records_of(("z",))
    point = point_of(records)
    both = score(records, point)

    alone = [
        score([rec], replace(point, trim=point.trim[j : j + 1], start=point.start[at]))
        for j, (rec, at) in enumerate(zip(records, segments(records), strict=True))
    ]
    assert both.log_likelihood == pytest.approx(sum(s.log_likelihood for s in alone), rel=1e-12)
    np.testing.assert_allclose(both.gradient[:3], sum(s.gradient[:3] for s in alone), rtol=1e-9)
    np.testing.assert_allclose(both.information[:3, :3], sum(s.information[:3, :3] for s in alone), rtol=1e-9)
    assert both.information[3, 4] == 0.0  # trims of two flights
    assert both.information[5, 6] == both.information[6, 7] == 0.0  # starts of two segments


# The levels


@pytest.mark.parametrize("axes", GROUPS)
def test_the_gradient_by_the_levels_agrees_with_differences_of_the_objective(axes: tuple[str, ...]) -> None:
    """To a ten thousandth of a standard error's worth: the program itself takes one-sided differences."""
    records = records_of(axes)
    point = point_of(records)
    free = np.ones(point.flat().size, bool)
    restricted = restriction(records, point_of(records, seed=1), free)
    here = score(records, point, restricted)
    levels = list(range(point.n, point.flat().size))

    expected = differences(lambda p: score(records, p, restricted).objective, point, levels, 1e-4)
    unit = np.sqrt(np.diag(here.information)[levels])
    np.testing.assert_allclose(here.gradient[levels] / unit, expected / unit, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("axes", [("z",), ("x", "y")])
def test_near_its_levels_the_adjustment_is_nearly_linear(axes: tuple[str, ...]) -> None:
    records = records_of(axes)
    point = point_of(records)
    restricted = restriction(records, point, np.ones(point.flat().size, bool))
    there = score(records, point, restricted)
    assert there.linear is not None
    same = score(records, point, there.linear)

    assert same.objective == pytest.approx(there.objective, rel=1e-12)
    for own, other in ((same.gradient, there.gradient), (same.information, there.information)):
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-12 * np.abs(other).max())
    assert there.exact
    assert not same.exact
    for by in (-0.1, 0.1):
        other = replace(point, levels=point.levels + by)
        assert there.linear.reaches(other.levels, 0.11)
        exact, linear = (score(records, other, how).adjustment for how in (restricted, there.linear))
        assert abs(exact - linear) < 0.05 * abs(exact - there.adjustment)
        assert adjustment(records, other, restricted) == pytest.approx(exact, rel=1e-12)
    assert not there.linear.reaches(other.levels, 0.09)


def test_the_objective_judges_the_coefficients_by_the_plain_likelihood() -> None:
    records = records_of(("z",))
    point = point_of(records)
    restricted = restriction(records, point, np.ones(point.flat().size, bool))
    other = point.with_flat(point.flat() + np.r_[0.1, 0.2, 0.01, np.zeros(9)])

    assert score(records, point, restricted).adjustment == score(records, other, restricted).adjustment
    np.testing.assert_array_equal(
        score(records, point, restricted).gradient[: point.n], score(records, point).gradient[: point.n]
    )


def whitening(rec: Record, levels: Array) -> tuple[Array, Array]:
    """The matrix that whitens one axis, (B, B), and the log variances, (B,)."""
    rows, variance = whiten(rec, np.eye(rec.count.size)[:, :, None], levels)
    return rows[:, :, 0], np.log(variance[:, 0])


def test_the_information_of_the_levels_is_in_the_mean_that_of_a_gaussian() -> None:
    """F_ij = tr(C^-1 dC_i C^-1 dC_j) / 2, the mean over data from the model itself."""
    rec = record(flown(Truth(), steps(), 4.0), ("z",))
    assert rec is not None
    point, levels = point_of([rec]), LEVELS[:1]

    def covariance(moved: Array) -> Array:
        W, _ = whitening(rec, moved)
        return np.linalg.inv(W.T @ W)

    W, _ = whitening(rec, levels)
    parts = []
    for i in range(4):
        h = np.zeros((1, 4))
        h[0, i] = 1e-4
        parts.append(W @ ((covariance(levels + h) - covariance(levels - h)) / 2e-4) @ W.T)
    expected = 0.5 * np.array([[np.sum(a * b.T) for b in parts] for a in parts])

    rng, total = np.random.default_rng(2), np.zeros((4, 4))
    mean, unwhite = response(rec, point, 0, point.start)[0], np.linalg.inv(W)
    free = np.ones(point.flat().size, bool)
    for _ in range(400):
        data = replace(rec, position=mean + (unwhite @ rng.standard_normal(rec.count.size))[:, None])
        total += score([data], point, restriction([data], point, free)).information[point.n :, point.n :] / 400
    unit = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(total / unit, expected / unit, rtol=0, atol=0.06)


def linear_case() -> tuple[Record, Point, Array]:
    """One axis with damping and delay held: what is left is linear in gain, trim and start velocity."""
    rec = record(flown(Truth(), steps(), 8.0), ("z",))
    assert rec is not None
    point = point_of([rec])
    free = np.ones(point.flat().size, bool)
    free[1:3] = False
    return rec, point, free


def closed_form(rec: Record, X: Array, levels: Array) -> tuple[float, Array]:
    """Restricted log-likelihood of y = X beta + n, less nothing, and the beta of generalised least squares."""
    W, log_variance = whitening(rec, levels)
    WX, Wy = W @ X, W @ rec.position[:, 0]
    beta, *_ = np.linalg.lstsq(WX, Wy, rcond=None)
    e = Wy - WX @ beta
    half_log = np.log(2 * np.pi) * e.size + log_variance.sum() + np.linalg.slogdet(WX.T @ WX)[1] + e @ e
    return float(-0.5 * half_log), beta


def design(rec: Record, point: Point) -> Array:
    """Responses to a unit of gain, trim and start velocity, shape (B, 3)."""
    out: Array = response(rec, point, 0, point.start)[1][:, [0, 3, 4], 0]
    return out


def test_in_a_linear_case_the_objective_is_the_restricted_likelihood_in_closed_form() -> None:
    rec, point, free = linear_case()
    X = design(rec, point)

    for shift in (0.0, 0.5, -1.0):
        levels = LEVELS[:1] + shift
        expected, beta = closed_form(rec, X, levels)
        here = replace(point, gain=beta[:1], trim=beta[None, 1:2], start=beta[None, 2:], levels=levels)
        assert score([rec], here, restriction([rec], here, free)).objective == pytest.approx(expected, rel=1e-9)
        np.testing.assert_allclose(response(rec, here, 0, here.start)[0][:, 0], X @ beta, rtol=0, atol=1e-12)


def test_in_a_linear_case_the_climb_ends_at_the_maximum_of_the_closed_form() -> None:
    from rotorfit.estimation.likelihood.fisher_scoring import maximise

    rec, point, free = linear_case()
    X = design(rec, point)
    optimum = maximise([rec], point, free, tolerance=1e-8)

    best = minimize(
        lambda v: -closed_form(rec, X, v[None])[0],
        optimum.point.levels[0],
        method="L-BFGS-B",
        bounds=LEVEL_RANGE,
        options={"ftol": 1e-14, "gtol": 1e-6},
    )
    expected, beta = closed_form(rec, X, optimum.point.levels)
    assert optimum.score.objective == pytest.approx(expected, abs=1e-5)
    assert -best.fun - optimum.score.objective < 1e-3
    np.testing.assert_allclose([optimum.point.gain[0], optimum.point.trim[0, 0]], beta[:2], rtol=1e-3)


# What follows from the information


def test_the_inverse_is_that_of_the_active_block_and_zero_elsewhere() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((5, 9)) * 10.0 ** rng.integers(-3, 4, 5)[:, None]
    information = root @ root.T
    active = np.array([True, False, True, True, False])

    out = inverted(information, active)
    expected = np.linalg.inv(information[np.ix_(active, active)])
    np.testing.assert_allclose(out[np.ix_(active, active)], expected, rtol=1e-6)
    assert not out[~active].any()
    assert not out[:, ~active].any()


def test_white_noise_of_one_unknown_level_leaves_a_degree_of_freedom_a_block() -> None:
    """Only the pose variance is unknown and everything is white: the textbook's Student t."""
    rec, point, free = linear_case()
    levels = np.log([[1e-10, 1e-5, 2.0, 0.5]])
    free = free.copy()
    free[point.n :] = [False, True, False, False]
    here = replace(point, levels=levels)
    W, _ = whitening(rec, levels)
    rng = np.random.default_rng(3)
    data = replace(
        rec,
        position=response(rec, here, 0, here.start)[0]
        + np.linalg.solve(W, rng.standard_normal(rec.count.size))[:, None],
    )

    found = score([data], here, restriction([data], here, free))
    direction = np.eye(point.n)[0]
    B = rec.count.size
    assert degrees_of_freedom(found, free, direction) == pytest.approx(B, rel=4 / np.sqrt(B))


def test_a_coefficient_hidden_by_slow_wind_has_fewer_degrees_of_freedom_than_one_of_fast_response() -> None:
    """The trim is told apart from wind of long memory by a few independent stretches only."""
    rec = record(flown(Truth(), steps(), 12.0), ("z",))
    assert rec is not None
    point = replace(point_of([rec]), levels=np.log([[0.02, 1e-7, 1.0, 0.2]]))
    free = np.ones(point.flat().size, bool)

    here = score([rec], point, restriction([rec], point, free))
    gain, trim = (degrees_of_freedom(here, free, np.eye(point.n)[i]) for i in (0, 3))
    assert trim < 0.5 * gain


@pytest.mark.parametrize("axes", GROUPS)
def test_the_cross_derivatives_are_those_of_the_gradient_by_the_levels(axes: tuple[str, ...]) -> None:
    records = records_of(axes)
    point = point_of(records)
    free = np.ones(point.flat().size, bool)
    restricted = restriction(records, point, free)
    cross = score(records, point, restricted).cross
    for i in range(point.levels.size):
        ends = []
        for side in (1, -1):
            values = point.flat()
            values[point.n + i] += side * 1e-4
            ends.append(score(records, point.with_flat(values)).gradient[: point.n])
        expected = (ends[0] - ends[1]) / 2e-4
        # q and r of one axis alone: the start's own variance is left out of the scaling, 1e-3 of the largest
        np.testing.assert_allclose(cross[:, i], expected, rtol=1e-3, atol=2e-3 * np.abs(expected).max())


def test_the_levels_add_little_to_a_well_excited_flight_and_more_to_a_short_noisy_one() -> None:
    shares = []
    for duration, noise in ((60.0, 5e-4), (12.0, 5e-3)):
        truth = replace(Truth(), wind_sigma=(0.2,) * 4, mocap_noise=(noise,) * 4)
        values = []
        for seed in range(4):
            records = [record(flown(truth, steps(("z",), seed=seed), duration, seed), ("z",))]
            assert records[0] is not None
            point = replace(point_of(records), gain=np.array([2.4596]), log_damping=np.log([2.1683]))
            free = np.ones(point.flat().size, bool)
            values.append(
                level_share(score(records, point, restriction(records, point, free)), free, np.eye(point.n)[1])
            )
        shares.append(np.mean(values))
    assert 0 <= shares[0] < 0.04
    assert shares[1] > 2 * shares[0]
