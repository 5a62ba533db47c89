"""Steady gain and total lag beside laws that models do not have: intervals that hold, hardly wider elsewhere."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from limited_flights import INNER, looped_inside
from other_laws import flown_by
from rotorfit.core.laws import STRUCTURES
from rotorfit.core.model import Axis
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.judgement.other_laws import between_laws, other_laws
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.estimand import estimands


def inside(value: float, ends: tuple[float | None, float | None]) -> bool:
    low, high = ends
    return low is not None and high is not None and low <= value <= high


@cache
def axes_of(turn: float) -> dict[str, Axis]:
    return dict(fit([looped_inside(turn)], axes=("x", "y")).model.axes)


@cache
def lagged() -> Estimate:
    flight = flown_by("first_order_delay_lag", ("x",), 30.0, seed=2, wind=0.1, noise=0.001)
    return fit([flight], axes=("x",), structure="first_order_delay_lag").estimates["x"]


@pytest.mark.parametrize("turn", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_intervals_hold_where_the_inner_loop_is_of_the_second_order(turn: float) -> None:
    axes = axes_of(turn)

    for name in "xy":
        for part, truth in INNER.items():
            assert inside(truth, axes[name].combinations[part].ci95)
        assert not inside(INNER["total_lag"], axes[name].combinations["total_lag"].ci95_flight)
        assert axes[name].status["input"] in ("ok", "refuted")  # of a law with one lag: what it does together is known


def test_another_law_that_is_likelier_is_evidence_with_its_total_lag() -> None:
    told = [one for axis in axes_of(0.0).values() for one in axis.evidence if one.test in ("order", "twice")]

    assert told
    for one in told:
        assert one.p_value < 0.001
        assert not one.refutes
        assert float(one.strength.split("total lag of ")[1].split()[0]) == pytest.approx(INNER["total_lag"], rel=0.06)


def test_a_vehicle_that_obeys_one_lag_gets_hardly_wider_intervals() -> None:
    estimate = lagged()
    wanted = {
        name: one
        for name, one in estimands(estimate.optimum, 0).items()
        if name in ("input", "damping", "steady_gain", "total_lag")
    }
    between = between_laws(other_laws(estimate), estimate, wanted)

    assert between is not None
    assert between.p_value > 0.001
    for name, one in wanted.items():
        assert abs(between.shift[name]) < one.error(estimate.optimum)
        assert between.factor[name] < 1.3


def test_a_law_without_a_lag_has_no_other_law_beside_it() -> None:
    flight = flown_by("first_order_delay", ("x",), 20.0, seed=2, wind=0.1, noise=0.001)
    estimate = fit([flight], axes=("x",), structure="first_order_delay").estimates["x"]

    assert other_laws(estimate) == ()


def test_the_second_order_begins_at_the_very_motion_of_one_lag() -> None:
    estimate = lagged()
    point = estimate.optimum.point
    second = next(one.optimum for one in other_laws(estimate) if not one.twice)

    assert second.point.structures == (STRUCTURES["second_order"],)
    assert second.score.log_likelihood > estimate.optimum.score.log_likelihood - 0.5
    assert point.structures == (STRUCTURES["first_order_delay_lag"],)


def test_the_lag_that_is_passed_twice_counts_twice_in_the_total_lag() -> None:
    estimate = lagged()
    point = estimate.optimum.point
    twice = replace(point, structures=(replace(point.structures[0], twice=True),))
    lag = point.extra_values(0)["lag"]

    once, both = (estimands(replace(estimate.optimum, point=one), 0)["total_lag"] for one in (point, twice))
    assert both.value - once.value == pytest.approx(lag)
    np.testing.assert_allclose(both.slope[3] - once.slope[3], lag)
