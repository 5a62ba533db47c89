"""What errors of the coefficients add to that of the wind: by the formula, and by filtering anew with others."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.likelihood import inverted
from rotorfit.tracking.air import courses
from rotorfit.tracking.refits import refitted
from rotorfit.tracking.replayed import until
from rotorfit.tracking.wind_error import coefficient_error
from tracked_flights import LAW, known_flight

pytestmark = pytest.mark.flights


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    return refitted(known_flight(), ("z",), LAW, 30.0).estimates["z"]


def anew(now: float, estimate: Estimate) -> float:
    """Standard error of the wind by moving the coefficients and the trim by a share of one standard error each way."""
    part, optimum, share = until(known_flight(), now), estimate.optimum, 0.1
    C = inverted(optimum.score.information, optimum.free)[: optimum.point.n, : optimum.point.n]
    root = np.linalg.cholesky(C + 1e-14 * np.eye(len(C)))
    winds = []
    for direction in (*root.T, np.zeros(len(C))):
        values = optimum.point.flat()
        values[: len(C)] += share * direction
        moved = replace(estimate, optimum=replace(optimum, point=optimum.point.with_flat(values)))
        winds.append(courses(part, {"z": moved}, {})[0]["z"].wind)
    return float(np.linalg.norm(np.array(winds[:-1]) - winds[-1]) / share)


def test_the_formula_is_what_filtering_anew_gives(estimate: Estimate) -> None:
    moments = np.arange(12.0, 30.0, 1.5)
    by_formula = [coefficient_error(until(known_flight(), now), "z", estimate, {}) for now in moments]
    by_filter = [anew(now, estimate) for now in moments]

    ratio = np.sqrt(np.mean(np.square(by_formula)) / np.mean(np.square(by_filter)))
    assert ratio == pytest.approx(1.0, abs=0.15)
    assert np.corrcoef(by_formula, by_filter)[0, 1] > 0.9


def test_it_is_wider_where_the_vehicle_is_known_less_well_than_the_information_says(estimate: Estimate) -> None:
    flight, twice = known_flight(), dict.fromkeys(COEFFICIENTS, 2.0)

    error = coefficient_error(flight, "z", estimate, {})
    assert coefficient_error(flight, "z", estimate, twice) == pytest.approx(2 * error)


@pytest.mark.parametrize("law", ["first_order_delay", "first_order_delay_lag"])
def test_a_delay_that_is_known_less_well_counts_with_or_without_a_lag(law: str) -> None:
    flight = known_flight()
    one = refitted(flight, ("z",), law, 30.0).estimates["z"]
    exact = {"input": 0.0, "damping": 0.0}

    known, vague = (coefficient_error(flight, "z", one, {**exact, "delay": delay}) for delay in (1.0, 20.0))
    assert vague > 1.02 * known
