"""Random effects: limits that are known, and intervals that hold for few flights."""

import numpy as np
import pytest

from rotorfit.core.model import NORMAL
from rotorfit.estimation.judgement.random_effects import mixed_half_width, random_effects


def test_flights_that_agree_give_their_weighted_mean() -> None:
    value, error = np.array([1.0, 1.2, 0.9]), np.array([0.1, 0.2, 0.1])

    told = random_effects(value, error, 1e-9)
    weight = error**-2
    assert told.mean == pytest.approx(weight @ value / weight.sum())
    assert told.sd == pytest.approx(weight.sum() ** -0.5, rel=1e-4)
    assert told.next_sd == pytest.approx(told.sd, rel=1e-4)


def test_one_flight_is_widened_by_the_prior_alone() -> None:
    told = random_effects(np.array([2.0]), np.array([1.0]), 1.0)

    assert told.mean == 2.0
    assert (told.reml, told.p_value) == (None, None)
    assert 1.5 < told.sd < 2.2  # sqrt(2) would be that of a known spread
    assert told.next_sd > told.sd


def test_flights_that_differ_leave_the_prior_behind() -> None:
    rng = np.random.default_rng(3)
    value, error = rng.normal(0.0, 1.0, 40), np.full(40, 0.1)

    told = random_effects(value, error, 0.1)
    assert told.spread == pytest.approx(value.std(ddof=1), rel=0.15)
    assert told.reml == pytest.approx(value.std(ddof=1), rel=0.05)
    assert told.sd == pytest.approx(value.std(ddof=1) / 40**0.5, rel=0.15)
    assert told.p_value is not None
    assert told.p_value < 1e-10


def test_reml_is_that_of_the_published_example() -> None:
    """BCG vaccine, thirteen trials: tau^2 = 0.3132.

    Source: W. Viechtbauer, J. Stat. Software 36 (2010) 3, section 3.1: yi, vi and the REML estimate.
    """
    yi = [-0.8893, -1.5854, -1.3481, -1.4416, -0.2175, -0.7861, -1.6209, 0.0120, -0.4694, -1.3713, -0.3394, 0.4459]
    vi = [0.3256, 0.1946, 0.4154, 0.0200, 0.0512, 0.0069, 0.2230, 0.0040, 0.0564, 0.0730, 0.0124, 0.5325]
    yi, vi = [*yi, -0.0173], [*vi, 0.0714]

    told = random_effects(np.array(yi), np.sqrt(vi), 1.0)
    assert told.reml is not None
    assert told.reml**2 == pytest.approx(0.3132, rel=0.02)
    assert told.mean == pytest.approx(-0.7145, abs=0.02)


@pytest.mark.parametrize(
    "flights", [1, pytest.param(2, marks=pytest.mark.slow), 3, pytest.param(6, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("ratio", [0.0, 0.5, 2.0])
def test_intervals_hold_for_few_flights(flights: int, ratio: float) -> None:
    """The spread drawn about its prior's scale, or none, or several times as much."""
    rng, inside, count = np.random.default_rng(flights), 0, 400
    for _ in range(count):
        error = rng.uniform(0.5, 2.0, flights)
        tau = ratio * abs(rng.standard_t(3))
        told = random_effects(rng.normal(0.0, np.hypot(error, tau)), error, 1.0)
        inside += abs(told.mean) < NORMAL * told.sd
    assert inside / count > (0.94 if ratio < 1 else 0.86)


def test_a_mixture_holds_95_per_cent() -> None:
    rng = np.random.default_rng(0)
    sd = np.array([1.0, 5.0])[(rng.uniform(size=400_000) < 0.2).astype(int)]

    half = mixed_half_width(np.array([1.0, 25.0]), np.array([0.8, 0.2]))
    assert np.mean(np.abs(sd * rng.standard_normal(sd.size)) < half) == pytest.approx(0.95, abs=0.002)


@pytest.mark.parametrize("flights", [4, 12])
def test_flights_that_differ_by_far_more_than_the_prior_expects_overrule_it(flights: int) -> None:
    """By three standard errors, ten times its scale: the half t alone holds 77 and 90 % (seed 1)."""
    rng, inside, count = np.random.default_rng(1), 0, 400
    for _ in range(count):
        told = random_effects(rng.normal(0.0, np.hypot(1.0, 3.0), flights), np.ones(flights), 0.3)
        inside += abs(told.mean) < NORMAL * told.sd
    assert inside / count > {4: 0.83, 12: 0.91}[flights]


def test_what_errors_of_the_law_explain_is_not_taken_for_a_spread() -> None:
    value, error = np.array([-3.0, 0.0, 3.0]), np.ones(3)

    alone, explained = random_effects(value, error, 0.3), random_effects(value, error, 0.3, law=3.0)
    assert explained.spread < 0.3 < 1.0 < alone.spread
    assert (explained.p_value, explained.reml) == (alone.p_value, alone.reml)


def test_precise_flights_that_differ_by_a_hundred_standard_errors_have_that_spread() -> None:
    found = random_effects(np.array([0.0, 0.4, 0.12, 0.32, 0.2]), np.full(5, 0.003), 0.001)

    assert found.reml is not None
    assert found.spread == pytest.approx(found.reml, rel=0.3)
    assert found.sd == pytest.approx(found.reml / np.sqrt(5), rel=0.2)


def test_the_spread_of_one_flight_is_the_median_of_its_prior() -> None:
    assert random_effects(np.array([1.0]), np.array([0.1]), 0.2).spread == pytest.approx(
        0.2 * 0.76489, rel=0.01
    )  # of |t3|
