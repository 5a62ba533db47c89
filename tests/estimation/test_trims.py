"""The prior variance of a new flight's trim: errors of the estimates are no trim."""

from dataclasses import replace

import numpy as np
import pytest

from flights import flown, steps
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import USUAL_TRIM
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.trims import new_trim_variance, trims_of
from rotorfit.simulation.paper_vehicle import Truth


def deviation(trim: list[float] | Array, error: list[float] | Array, axis: str = "x") -> float:
    return float(np.sqrt(new_trim_variance(np.array(trim), np.square(error), axis)))


def test_well_known_trims_count_as_they_are() -> None:
    trim = [0.05, -0.1, 0.02]

    assert deviation(trim, [1e-4] * 3) == pytest.approx(np.sqrt(np.mean(np.square(trim))), rel=1e-3)


@pytest.mark.parametrize("axis", AXES)
def test_an_unknown_trim_is_one_of_the_class(axis: str) -> None:
    usual = USUAL_TRIM[AXES.index(axis)]

    assert usual / 3 < deviation([-9 * usual], [17 * usual], axis) < 6 * usual  # a Bebop's z: -0.46 +- 0.87 m/s^2


def test_a_certain_trim_is_believed_however_far_outside_the_class() -> None:
    assert deviation([-7.0], [0.7]) == pytest.approx(7.0, rel=0.05)


def test_errors_of_many_flights_are_no_trim() -> None:
    rng = np.random.default_rng(1)
    trim, error = 0.03 * rng.standard_normal(400), np.full(400, 0.1)
    seen = trim + error * rng.standard_normal(400)

    assert deviation(seen, error) == pytest.approx(0.03, rel=0.5)
    assert np.sqrt(np.mean(seen**2 + error**2)) > 4 * 0.03  # the same under a flat prior


def test_it_is_never_larger_than_under_a_flat_prior() -> None:
    rng = np.random.default_rng(2)

    for flights in (1, 2, 5):
        trim, error = rng.standard_normal((2, 20, flights)) * 10.0 ** rng.uniform(-3, 1, (2, 20, 1))
        for c, s in zip(trim, error, strict=True):
            assert 0 < deviation(c, s) < np.sqrt(np.mean(c**2 + s**2)) + 1e-6


def test_a_published_model_states_it() -> None:
    flights = [flown(replace(Truth(), trim=(0.0, 0.0, trim, 0.0)), steps(("z",)), 30.0, 4) for trim in (0.05, -0.1)]
    fitted = fit(flights, axes=("z",), structure="first_order_delay")

    trim, variance = trims_of(fitted.estimates["z"].optimum)
    stated = fitted.model.axes["z"].noise["trim_variance"]
    assert stated == new_trim_variance(trim[:, 0], variance[:, 0], "z")
    assert np.mean(trim**2 - 2 * variance) < stated < np.mean(trim**2)
