"""Lines drawn between commands are recognised, and smooth, rounded, ramped and held commands are not taken for them."""

import numpy as np
import pytest

from rotorfit.core.frames import Array
from rotorfit.flights.drawn_lines import period_of_lines

RNG = np.random.default_rng(0)
SENT = np.arange(0.0, 60.2, 0.05)
ROWS = np.arange(0.1, 60.0, 0.02)
UNEVEN = ROWS + 0.001 * RNG.standard_normal(ROWS.size)


def smooth(time: Array) -> Array:
    return np.stack([0.3 * np.sin(w * time + w) + 0.1 * np.sin(3 * w * time) for w in (0.9, 1.3, 2.1, 2.9)], axis=1)


def drawn(time: Array) -> Array:
    return np.stack([np.interp(time, SENT, sent) for sent in smooth(SENT).T], axis=1)


def period(time: Array, values: Array) -> float:
    return period_of_lines(np.round(time * 1e9).astype(np.int64), values)


@pytest.mark.parametrize("time", [ROWS, UNEVEN])
def test_commands_interpolated_onto_rows(time: Array) -> None:
    assert period(time, drawn(time)) == pytest.approx(0.05, rel=0.02)
    assert period(time, drawn(time)[:, :1]) == pytest.approx(0.05, rel=0.02)
    assert period(time, drawn(time).round(6)) == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("every", [0.05, 0.1])
def test_commands_interpolated_and_rounded_to_five_decimals(every: float) -> None:
    rows, sent = np.arange(0.1, 60.0, 1 / 120), np.arange(0.0, 60.2, every)
    values = np.stack([np.interp(rows, sent, one) for one in smooth(sent).T], axis=1)

    assert period(rows.round(5), values.round(5)) == pytest.approx(every, rel=0.02)
    assert period(rows.round(5), smooth(rows).round(5)) == 0.0
    assert period(rows.round(5), smooth(0.2 * rows).round(5)) == 0.0


def test_steps_that_became_ramps() -> None:
    sent = SENT + RNG.uniform(0, 0.002, SENT.size)
    level = RNG.integers(-1, 2, (70, 4))[sent.astype(int)] * 0.2
    for rows, error in ((ROWS, 0.25), (np.arange(0.1, 60.0, 0.005), 0.1)):
        values = np.stack([np.interp(rows, sent, one) for one in level.T], axis=1)
        assert period(rows, values) == pytest.approx(0.05, rel=error)


def test_commands_interpolated_by_the_number_of_the_row() -> None:
    near = np.searchsorted(UNEVEN, SENT[3:-5])
    values = np.stack([np.interp(np.arange(ROWS.size), near, sent) for sent in smooth(SENT)[3:-5].T], axis=1)

    assert period(UNEVEN, values) == pytest.approx(0.05, rel=0.02)


def test_commands_interpolated_beside_their_own_rows() -> None:
    time = np.unique(np.concatenate([UNEVEN, SENT]))

    assert period(time, drawn(time)) == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize("time", [ROWS, UNEVEN])
def test_what_is_not_drawn(time: Array) -> None:
    level = RNG.uniform(-0.3, 0.3, (70, 4))[(time).astype(int)]
    ramps = np.stack([np.convolve(np.round(one, 1), np.ones(10) / 10)[: time.size] for one in level.T], axis=1)
    limited = level.copy()
    for k in range(1, len(limited)):
        limited[k] = limited[k - 1] + np.clip(level[k] - limited[k - 1], -0.01, 0.01)
    stick = np.cumsum(RNG.integers(-20, 21, (time.size, 4)), axis=0) * 1e-3 * [1, 0, 0, 0]
    slow = 0.3 * np.sin(0.4 * time)[:, None]
    held = drawn(SENT)[np.searchsorted(SENT, time) - 1]

    for values in (
        smooth(time),
        smooth(time).round(3),
        smooth(time).round(5),
        level,
        ramps,
        limited,
        stick,
        slow,
        held,
    ):
        assert period(time, values) == 0.0
    assert period(time[:20], drawn(time[:20])) == 0.0
    assert period(time, np.zeros((time.size, 4))) == 0.0
    assert period(time, 1e-300 * smooth(time)) == 0.0
