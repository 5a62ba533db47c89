"""The tones of a command: sines that stand out of its spectrum as lines, as those of a multisine do.

Every peak of the spectrum behind a Hann window is taken for a line, all of them are fitted together, and those that
stand far out of what is then left around them are tones. In a feedback loop they are what was added to the command
from outside: what answers the motion has a spectrum without lines.

Source: F. J. Harris, Proc. IEEE 66 (1978), pp. 51-83 (the window, and what two lines must be apart behind it).
"""

from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array

STANDS_OUT = 25.0
"""Power of a tone over the median of what is left around it. Of 1,000 frequencies of noise none exceeds 20 in 99 %."""

SURROUNDINGS = 8
"""Bins, of one over the duration, to each side whose median is compared."""

APART = 1.2
"""Bins to each side of a line that are its own."""

SLOWEST = 2.5
"""Lowest frequency of a line, in bins: below, a drift looks like one."""

LEAST = 1e-2
"""Power of a line over that of the highest below which it is not looked at."""

PADDING = 8
"""Points of the spectrum a bin."""


@dataclass(frozen=True)
class Tones:
    """The lines of a signal, sum_k a_k cos(w_k t) + b_k sin(w_k t).

    Attributes:
        frequency: Increasing, shape (K,) [rad/s].
        cosine: a, shape (K,).
        sine: b, shape (K,).
        share: Of the signal's variance that they explain.
    """

    frequency: Array
    cosine: Array
    sine: Array
    share: float

    def value(self, time: Array) -> Array:
        """The sum at some times, shape of time [s]."""
        turn = np.multiply.outer(time, self.frequency)
        return np.asarray(np.cos(turn) @ self.cosine + np.sin(turn) @ self.sine)


def tones_of(time: Array, signal: Array, highest: float) -> Tones:
    """The tones of a signal.

    Args:
        time: Regular, shape (N,) [s].
        signal: Shape (N,).
        highest: Frequency up to which lines are looked for [rad/s].
    """
    middle, step = time.mean(), float(time[1] - time[0])
    t, bin_ = time - middle, 2 * np.pi / (step * time.size)
    signal = signal - signal.mean()
    found = _refined(t, signal, _peaks(t, signal, bin_, highest), bin_)
    rest = signal - _explained(t, signal, found)
    found = found[[_stands_out(t, signal, rest, line, bin_) for line in found]]
    columns = _columns(t, found)
    weights = np.linalg.lstsq(columns, signal)[0]
    rest, power = signal - columns @ weights, float(signal @ signal)
    a, b = weights[: found.size], weights[found.size :]
    c, s = np.cos(found * middle), np.sin(found * middle)
    share = 1 - float(rest @ rest) / power if power > 0 else 0.0
    return Tones(found, a * c - b * s, a * s + b * c, share)


def _peaks(t: Array, signal: Array, bin_: float, highest: float) -> Array:
    """Peaks of the spectrum behind a Hann window, increasing, shape (K,) [rad/s]."""
    power = np.abs(np.fft.rfft(signal * np.hanning(t.size), PADDING * t.size)) ** 2
    power = power[: int(PADDING * highest / bin_)]
    top = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    top = top[(top >= SLOWEST * PADDING) & (power[top] > LEAST * power.max(initial=0.0))]
    low, middle, high = (np.sqrt(power[top + k]) for k in (-1, 0, 1))
    return np.asarray(bin_ / PADDING * (top + 0.5 * (low - high) / (low - 2 * middle + high)))


def _stands_out(t: Array, signal: Array, rest: Array, line: float, bin_: float) -> bool:
    """Whether a line is far above what is left around it; at its own place nothing is left."""
    around = line + bin_ * np.arange(-SURROUNDINGS, SURROUNDINGS + 1)
    around = around[(np.abs(around - line) > APART * bin_) & (around > 0)]
    near = np.median(np.abs(np.exp(-1j * np.multiply.outer(around, t)) @ rest) ** 2)
    return bool(np.abs(np.exp(-1j * line * t) @ signal) ** 2 > STANDS_OUT * near)


def _columns(t: Array, frequency: Array) -> Array:
    turn = np.multiply.outer(t, frequency)
    return np.hstack([np.cos(turn), np.sin(turn)])


def _explained(t: Array, signal: Array, frequency: Array) -> Array:
    columns = _columns(t, frequency)
    return np.asarray(columns @ np.linalg.lstsq(columns, signal)[0])


def _refined(t: Array, signal: Array, frequency: Array, bin_: float) -> Array:
    """Frequencies after a step of Gauss and Newton, no longer than a quarter of a bin."""
    K, columns = frequency.size, _columns(t, frequency)
    weights = np.linalg.lstsq(columns, signal)[0]
    slope = t[:, None] * (columns[:, :K] * weights[K:] - columns[:, K:] * weights[:K])
    step = np.linalg.lstsq(np.hstack([columns, slope]), signal - columns @ weights)[0][2 * K :]
    return np.asarray(frequency + np.clip(step, -bin_ / 4, bin_ / 4))
