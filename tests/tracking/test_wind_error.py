"""What errors of the coefficients add to those of the wind and of the second ahead: by the formula, and by filtering
anew with others."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.flight_data import Flight
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.likelihood import inverted
from rotorfit.tracking.air import courses, doubts_of
from rotorfit.tracking.refits import refitted
from rotorfit.tracking.replayed import until
from rotorfit.tracking.wind_error import Doubt
from tracked_flights import LAW, known_flight

pytestmark = pytest.mark.flights


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return refitted(known_flight(), ("z",), LAW, 30.0).estimates["z"]


def anew(now: float, estimate: Estimate) -> tuple[float, float]:
    """Standard errors of wind and prediction by moving the coefficients and the trim by a share of one of theirs."""
    part, optimum, share = until(known_flight(), now), estimate.optimum, 0.1
    C = inverted(optimum.score.information, optimum.free)[: optimum.point.n, : optimum.point.n]
    root = np.linalg.cholesky(C + 1e-14 * np.eye(len(C)))
    told = []
    for direction in (*root.T, np.zeros(len(C))):
        values = optimum.point.flat()
        values[: len(C)] += share * direction
        moved = replace(estimate, optimum=replace(optimum, point=optimum.point.with_flat(values)))
        now_z = courses(part, {"z": moved}, {})[0]["z"]
        told.append((now_z.wind, now_z.ahead))
    wind, ahead = np.linalg.norm(np.array(told[:-1]) - told[-1], axis=0) / share
    return float(wind), float(ahead)


def by_formula(flight: Flight, estimate: Estimate, widened: Mapping[str, float]) -> Doubt:
    return doubts_of(flight, {"z": estimate}, {"z": widened}, courses(flight, {"z": estimate}, {})[0])["z"]


def test_the_formula_is_what_filtering_anew_gives(estimate: Estimate) -> None:
    moments = np.arange(12.0, 30.0, 1.5)
    told = [by_formula(until(known_flight(), now), estimate, {}) for now in moments]
    by_filter = np.transpose([anew(now, estimate) for now in moments])

    for formula, filtered in zip(([one.wind for one in told], [one.ahead for one in told]), by_filter, strict=True):
        ratio = np.sqrt(np.mean(np.square(formula)) / np.mean(np.square(filtered)))
        assert ratio == pytest.approx(1.0, abs=0.15)
        assert np.corrcoef(formula, filtered)[0, 1] > 0.9


def test_it_is_wider_where_the_vehicle_is_known_less_well_than_the_information_says(estimate: Estimate) -> None:
    flight, twice = known_flight(), dict.fromkeys(COEFFICIENTS, 2.0)

    once, more = by_formula(flight, estimate, {}), by_formula(flight, estimate, twice)
    assert more.wind == pytest.approx(2 * once.wind)
    assert more.ahead == pytest.approx(2 * once.ahead)


@pytest.mark.parametrize("law", ["first_order_delay", "first_order_delay_lag"])
def test_a_delay_that_is_known_less_well_counts_with_or_without_a_lag(law: str) -> None:
    flight = known_flight()
    one = refitted(flight, ("z",), law, 30.0).estimates["z"]
    exact = {"input": 0.0, "damping": 0.0}

    known, vague = (by_formula(flight, one, {**exact, "delay": delay}) for delay in (1.0, 20.0))
    assert vague.wind > 1.02 * known.wind
    assert vague.ahead > 1.02 * known.ahead
