"""The sandwich: covariance of what has coloured residuals, and the quantile that goes with it."""

import numpy as np
import pytest

from rotorfit.estimation.regression.sandwich import fixed_b_quantile, sandwich


def coloured(rng: np.random.Generator, n: int, memory: float) -> np.ndarray:
    """An autoregression of unit variance."""
    noise, out = rng.standard_normal(n), np.empty(n)
    out[0] = noise[0]
    for i in range(1, n):
        out[i] = memory * out[i - 1] + np.sqrt(1 - memory**2) * noise[i]
    return out


def test_white_scores_give_the_textbook_variance_of_a_mean() -> None:
    rng = np.random.default_rng(1)
    score = rng.standard_normal((4000, 1))
    found = sandwich([np.arange(4000.0)], [score - score.mean()], np.array([[4000.0]]), 1.0)

    assert found is not None
    assert found.covariance[0, 0] == pytest.approx(1 / 4000, rel=0.15)


def test_the_quantile_starts_at_that_of_the_normal_distribution_and_rises() -> None:
    assert fixed_b_quantile(0.0) == pytest.approx(1.96)
    assert np.all(np.diff([fixed_b_quantile(share) for share in np.linspace(0, 1, 11)]) > 0)


def test_intervals_of_a_mean_under_a_long_memory_hold_the_truth_where_the_normal_quantile_fails() -> None:
    """400 series, seed 2."""
    rng, held, plain = np.random.default_rng(2), 0, 0
    for _ in range(400):
        series = coloured(rng, 400, 0.9)
        found = sandwich([np.arange(400.0)], [(series - series.mean())[:, None]], np.array([[400.0]]), 10.0)
        assert found is not None
        error = abs(series.mean()) / np.sqrt(found.covariance[0, 0])
        held += error < found.quantile
        plain += error < 1.96
    assert held / 400 > 0.9
    assert plain < held - 10


def test_what_cannot_be_told_apart_or_leaves_nothing_over_has_no_covariance() -> None:
    time, score = np.arange(100.0), np.random.default_rng(3).standard_normal((100, 2))

    assert sandwich([time], [score], np.ones((2, 2)), 1.0) is None
    assert sandwich([time], [0 * score], np.eye(2), 1.0) is None
    assert sandwich([time], [score], np.eye(2) * np.nan, 1.0) is None
