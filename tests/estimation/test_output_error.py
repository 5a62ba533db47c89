"""Output error: its gradient, its covariance by a second method, its bounds."""

from dataclasses import replace

import numpy as np
import pytest

from flights import STILL, flown, steps
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.likelihood import whiten
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.regression.output_error import squares_of, sum_variance

LEVELS = np.array([3e-3, 4e-7, 2.5, 0.5])


def plane() -> tuple[list[Record], Point]:
    flight = flown(STILL, steps(("x", "y", "yaw")), 12.0)
    rec = record(flight, ("x", "y"))
    assert rec is not None
    point = start_point([rec], 0.2, 0.4, np.tile(np.log(LEVELS), (2, 1)))
    return [rec], replace(point, gain=np.array([3.0, 3.5]), trim=np.array([[0.02, -0.01]]))


def test_the_gradient_is_that_of_the_sum_of_squares() -> None:
    records, point = plane()
    found = squares_of(records, point)

    for i in range(point.n):
        step = np.zeros(point.flat().size)
        step[i] = 1e-6
        up, down = (squares_of(records, point.with_flat(point.flat() + sign * step)).total for sign in (1, -1))
        assert -0.5 * (up - down) / 2e-6 == pytest.approx(found.gradient[i], rel=1e-4, abs=1e-6)


def test_the_variance_of_sums_is_that_of_the_dense_covariance_of_the_filter() -> None:
    """The filter whitens, so the inverse of what it does to single blocks is the covariance."""
    rec = record(flown(STILL, steps(("z",)), 8.0), ("z",))
    assert rec is not None
    rows, _ = whiten(rec, np.eye(rec.count.size)[:, :, None], np.log(LEVELS)[None])
    dense = np.linalg.inv(rows[:, :, 0].T @ rows[:, :, 0])
    weights = np.random.default_rng(1).normal(size=(rec.count.size, 3)).cumsum(axis=0)
    weights -= weights.mean(axis=0)

    np.testing.assert_allclose(sum_variance(rec, weights, LEVELS), weights.T @ dense @ weights, rtol=1e-3)
