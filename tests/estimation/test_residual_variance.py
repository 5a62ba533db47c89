"""How much wider an interval is for coloured or unequal innovations: nothing where they are as believed."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.frames import Array
from rotorfit.estimation.judgement.residual_variance import Ratio, Weighted, widening

STEP = 1 / 30


def slow_weights(count: int) -> Array:
    t = STEP * np.arange(count)
    return (np.sin(2 * np.pi * 0.1 * t) + 0.5 * np.sin(2 * np.pi * 0.37 * t))[:, None, None]


def seen(innovation: Array) -> Weighted:
    weight = slow_weights(innovation.size)
    return Weighted(STEP * np.arange(innovation.size), innovation[:, None], weight, weight, np.zeros(1))


def coloured(rng: np.random.Generator, count: int, memory: float) -> Array:
    """White noise plus as much of a first-order autoregression."""
    slow, white = np.zeros(count), rng.standard_normal(count)
    for i in range(1, count):
        slow[i] = memory * slow[i - 1] + white[i]
    return slow


def test_white_innovations_keep_their_intervals() -> None:
    rng = np.random.default_rng(1)
    factors = [widening([seen(rng.standard_normal(1800))], ["a"])["a"] for _ in range(300)]

    assert np.mean(factors) < 1.02
    assert np.mean(np.array(factors) > 1.1) < 0.09
    assert min(factors) == 1.0


def test_colour_at_the_frequencies_of_the_weights_widens_by_its_spectrum() -> None:
    rng, memory = np.random.default_rng(2), 0.8
    factors = [widening([seen(coloured(rng, 3600, memory))], ["a"])["a"] for _ in range(40)]

    assert np.mean(factors) == pytest.approx(1 / (1 - memory), rel=0.1)  # of a sum of an autoregression


def test_colour_elsewhere_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    white = rng.standard_normal(3601)
    factor = widening([seen((white[1:] - white[:-1]) / 2**0.5)], ["a"])["a"]

    assert factor == 1.0


def test_innovations_that_are_large_where_the_weights_are_widen() -> None:
    rng = np.random.default_rng(4)
    weight = np.where(np.arange(1800) < 450, 1.0, 0.05)[:, None, None] * slow_weights(1800)
    size = np.where(np.arange(1800) < 450, 1.7, 0.6)
    one = seen(rng.standard_normal(1800) * size)
    factor = widening([Weighted(one.time, one.innovation, weight, weight, np.zeros(1))], ["a"])["a"]

    assert factor == pytest.approx(1.7, rel=0.25)


@pytest.mark.parametrize("apart", [0.0, 0.001])
def test_positions_and_velocities_of_one_moment_are_smoothed_over_the_same_time(apart: float) -> None:
    rng, early = np.random.default_rng(4), np.arange(1800) < 450
    weight = np.where(early, 1.0, 0.05)[:, None, None] * slow_weights(1800)
    one = replace(seen(rng.standard_normal(1800) * np.where(early, 1.7, 0.6)), weight=weight, span=weight)
    pairs = np.repeat(one.time[::2], 2) + np.tile([0.0, apart], 900)

    found = widening([replace(one, time=pairs)], ["a"])["a"]
    assert found == pytest.approx(widening([one], ["a"])["a"])
    assert found > 1.3


def test_a_ratio_counts_as_far_as_it_is_no_chance() -> None:
    assert Ratio(0.7, 0.01).beyond_chance == 1.0
    assert Ratio(1.1, 0.01).beyond_chance == 1.0
    assert Ratio(3.0, 0.01).beyond_chance == pytest.approx(3.0, rel=0.01)
