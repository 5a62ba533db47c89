"""The vehicle behind the wind: that of the flight, unless gusts hide its drag."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from flights import STILL, flown, steps
from rotorfit.core.model import Interval
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.estimand import estimands
from rotorfit.estimation.likelihood.prior import GaussianPrior
from rotorfit.tracking.drag import DRAG_SPREAD, OPEN, damping_interval, tells_wind, widening, with_drag
from rotorfit.tracking.following import Following
from rotorfit.tracking.refits import GroupEstimate, axis_report, refitted
from rotorfit.tracking.replayed import until
from tracked_flights import LAW, changing, known_flight, tilted

pytestmark = pytest.mark.flights
AXES = ("x", "y")


@pytest.fixture(scope="module")
def gusty() -> tuple[Any, GroupEstimate]:
    """Half a minute in gusts of 5 m/s, in which the damping of x seems to be 0."""
    room = changing()
    flown_ = room.changing_flight(SEED, room.Scenario("none", "bebop2", gusts=5.0, mean=3.0, duration=30.0))
    return flown_, refitted(flown_.flight, AXES, LAW, 30.0)


SEED = 916


@cache
def of_z() -> GroupEstimate:
    """z, whose commands are no tilts."""
    return refitted(until(known_flight(), 20.0), ("z",), LAW, 20.0)


def dampings(estimates: Mapping[str, Estimate]) -> np.ndarray:
    return np.array([estimands(one.optimum, one.place)["damping"].value for one in estimates.values()])


def own(fitted: GroupEstimate) -> dict[str, Mapping[str, Interval]]:
    return {axis: axis_report(fitted, axis).ci95_flight for axis in fitted.estimates}


def test_in_gusts_the_prior_keeps_the_drag_from_zero(gusty: tuple[Any, GroupEstimate]) -> None:
    flown_, fitted = gusty
    true = np.array(flown_.linear[0].gamma[1:4:2])
    found = with_drag(flown_.flight.card, fitted.estimates, own(fitted))

    off, alone = (np.abs(np.log(dampings(one) / true)) for one in (found, fitted.estimates))
    assert alone.max() > 2.0
    assert off.max() < 1.0
    for axis, b in zip(AXES, true, strict=True):
        widened = widening(fitted.estimates[axis], axis_report(fitted, axis).ci95)
        low, high = damping_interval(found[axis], widened)
        assert low is not None
        assert high is not None
        assert low < b < high
        assert np.log(high / low) < 2 * 1.96 * DRAG_SPREAD * max(widened["damping"], 1.0)


def test_only_the_wind_knows_the_prior(gusty: tuple[Any, GroupEstimate]) -> None:
    """The wind is told in such gusts; no damping is."""
    flight = gusty[0].flight
    following = Following(LAW)
    state = following.look(flight, float(flight.pose_time[-1]))

    assert all(state.axes[axis].wind is not None for axis in AXES)
    assert state.air is not None
    assert state.axes["x"].values["damping"] is None
    assert state.axes["x"].ci95["damping"][0] is None


def test_where_the_flight_tells_the_drag_the_prior_does_not_matter() -> None:
    flight = tilted(flown(STILL, steps(AXES, seed=8), 14.0, seed=8))
    fitted = refitted(flight, AXES, LAW, 14.0)
    found = with_drag(flight.card, fitted.estimates, own(fitted))

    assert dampings(found) == pytest.approx(dampings(fitted.estimates), rel=0.01)


def test_axes_without_tilts_keep_their_estimates() -> None:
    estimates = of_z().estimates
    assert with_drag(known_flight().card, estimates, {})["z"] is estimates["z"]


def test_a_prior_of_the_card_stays(gusty: tuple[Any, GroupEstimate]) -> None:
    flown_, fitted = gusty
    sharp = np.array([0.0, 0.0, 1e6, 1e6, 0.0, 0.0])
    mean = np.array([0.0, 0.0, np.log(0.3), np.log(0.4), 0.0, 0.0])
    estimates = {
        axis: replace(one, optimum=replace(one.optimum, prior=GaussianPrior(mean, sharp)))
        for axis, one in fitted.estimates.items()
    }
    first = estimates["x"].optimum
    estimates = {axis: replace(one, optimum=first) for axis, one in estimates.items()}

    assert dampings(with_drag(flown_.flight.card, estimates, {})) == pytest.approx([0.3, 0.4], rel=1e-2)


def test_an_interval_twice_as_wide_is_twice_as_uncertain() -> None:
    estimate = of_z().estimates["z"]
    one = estimands(estimate.optimum, estimate.place)["delay"]
    half = 1.96 * one.error(estimate.optimum)

    assert widening(estimate, {})["delay"] == 1.0
    assert widening(estimate, {"delay": (None, None)})["delay"] == OPEN
    assert widening(estimate, {"delay": (one.value - half, one.value + 2 * half)})["delay"] == pytest.approx(
        2.0, rel=1e-3
    )


def test_drag_need_not_be_known() -> None:
    told = {"input": (2.0, 3.0), "damping": (1.0, 2.0), "delay": (0.1, 0.2)}
    assert tells_wind(told, drag=False)
    assert not tells_wind(told | {"damping": (None, 2.0)}, drag=False)
    assert tells_wind(told | {"damping": (None, 2.0)}, drag=True)
    assert not tells_wind(told | {"damping": (None, 2.0), "input": (1.0, None)}, drag=True)
    assert not tells_wind({}, drag=True)
