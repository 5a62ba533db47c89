"""The block bootstrap: drawn flights are of the fitted model's kind, and their estimates scatter as they should."""

from functools import cache

import numpy as np
import pytest

from flights import flown, steps
from rotorfit.assessment.bootstrap import BLOCK_TIME, bootstrap, coloured, resampled_blocks
from rotorfit.estimation.likelihood.axis_estimate import Estimate, estimate_axis
from rotorfit.estimation.likelihood.blocks import record
from rotorfit.estimation.likelihood.likelihood import inverted, whiten
from rotorfit.simulation.paper_vehicle import Truth


@cache
def estimate() -> Estimate:
    return estimate_axis([flown(Truth(), steps(("z",), seed=4), 30.0, 4)], "z", True)


@pytest.mark.parametrize("axes", [("z",), ("x", "y")])
def test_colouring_is_the_inverse_of_whitening(axes: tuple[str, ...]) -> None:
    rec = record(flown(Truth(), steps(("x", "y", "yaw"), seed=1), 8.0, 1), axes)
    assert rec is not None
    K = len(axes)
    levels = np.log([[0.002, 3e-7, 2.0, 0.6], [0.01, 1e-6, 4.0, 0.2]])[:K]
    innovations = np.random.default_rng(0).standard_normal((rec.count.size, 3, K))

    back, _ = whiten(rec, coloured(rec, innovations, levels), levels)
    np.testing.assert_allclose(back, innovations, atol=1e-7)


def test_innovations_are_drawn_in_runs_and_each_segment_keeps_its_first() -> None:
    fresh = np.zeros(600, bool)
    fresh[[0, 250]] = True

    index = resampled_blocks(fresh, 60, 50, np.random.default_rng(1))
    assert index.shape == (600, 50)
    np.testing.assert_array_equal(index[fresh], [[0] * 50, [250] * 50])
    assert np.isin(index[~fresh], np.flatnonzero(~fresh)).all()
    assert np.mean(np.diff(index, axis=0) == 1) > 0.95
    assert np.unique(index[:, 0]).size < 600


def test_the_scatter_of_the_drawn_flights_is_the_expected_one_where_the_model_is_true() -> None:
    optimum = estimate().optimum
    error = np.sqrt(np.diag(inverted(optimum.score.information, optimum.free)))[:3]

    spread = bootstrap(estimate().records, optimum, 100)[:, :3].std(axis=0, ddof=1)
    np.testing.assert_allclose(spread / error, 1.0, atol=0.35)


def test_the_same_seed_draws_the_same_flights_and_leaves_the_optimum_as_it_was() -> None:
    before = estimate().optimum.point.flat().copy()

    first, again, other = (bootstrap(estimate().records, estimate().optimum, 3, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, other)
    np.testing.assert_array_equal(estimate().optimum.point.flat(), before)


def test_blocks_are_longer_than_the_delay_that_is_searched() -> None:
    from rotorfit.core.laws import DELAY_RANGE

    assert 2 * DELAY_RANGE[1] < BLOCK_TIME
