"""The tones of a command: sines that stand out of its spectrum as lines, as those of a multisine do.

Every peak of the spectrum with a Hann window is taken for a line, all lines are fitted together, and those that stand
far above the residual around them are tones. In a feedback loop they are what was added to the command from outside:
the response to the motion has a spectrum without lines.

Source: F. J. Harris, Proc. IEEE 66 (1978), pp. 51-83 (the window, and what two lines must be apart behind it).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array, Mask
from rotorfit.core.frequency_response import Spectrum
from rotorfit.dynamics.irregular_fourier import IrregularFourier

SOME_TONES = 0.6
"""Share of a command's variance in its tones above which they serve as the instrument in a feedback loop."""

STANDS_OUT = 25.0
"""Power of a tone over the median of the residual around it. Of 1,000 frequencies of noise none exceeds 20 in 99 %."""

SURROUNDINGS = 8
"""Bins to each side (one bin: 2 pi over the duration) whose median is compared."""

APART = 1.2
"""Bins to each side of a line that belong to it."""

SLOWEST = 2.5
"""Lowest frequency of a line, in bins: below, a drift looks like one."""

LEAST = 1e-2
"""Power of a line, relative to the highest, below which it is ignored."""

PADDING = 8
"""Points of the spectrum per bin."""

CONVERGED = 1e-12
"""Gradient of the sum of squares, relative to the first, at which a solution has converged."""

MOST_STEPS = 200
"""Number of steps after which a solution is accepted anyway: two nearly equal lines share their weight arbitrarily."""


@dataclass(frozen=True)
class Tones:
    """The lines of a signal, sum_k a_k cos(w_k t) + b_k sin(w_k t).

    Attributes:
        frequency: Increasing, shape (K,) [rad/s].
        cosine: a, shape (K,).
        sine: b, shape (K,).
        share: Share of the signal's variance that they explain.
    """

    frequency: Array
    cosine: Array
    sine: Array
    share: float

    def value(self, time: Array) -> Array:
        """The sum at regular times, shape (N,) [s]."""
        return _Lines(time, self.frequency).sum(self.cosine + 1j * self.sine)


def tones_of(time: Array, signal: Array, highest: float) -> Tones:
    """The tones of a signal.

    Args:
        time: Regular, shape (N,) [s].
        signal: Shape (N,).
        highest: Frequency up to which lines are searched [rad/s].
    """
    middle, step = time.mean(), float(time[1] - time[0])
    t, bin_ = time - middle, 2 * np.pi / (step * time.size)
    signal = signal - signal.mean()
    found = _refined(t, signal, _peaks(t, signal, bin_, highest), bin_)
    rest = _Lines(t, found).fitted(signal)[1]
    found = found[_stand_out(t, signal, rest, found, bin_)]
    weights, rest = _Lines(t, found).fitted(signal)
    a, b, power = weights.real, weights.imag, float(signal @ signal)
    c, s = np.cos(found * middle), np.sin(found * middle)
    share = 1 - float(rest @ rest) / power if power > 0 else 0.0
    return Tones(found, a * c - b * s, a * s + b * c, share)


def _peaks(t: Array, signal: Array, bin_: float, highest: float) -> Array:
    """Peaks of the spectrum with a Hann window, increasing, shape (K,) [rad/s]."""
    power = np.abs(np.fft.rfft(signal * np.hanning(t.size), PADDING * t.size)) ** 2
    power = power[: int(PADDING * highest / bin_)]
    top = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    top = top[(top >= SLOWEST * PADDING) & (power[top] > LEAST * power.max(initial=0.0))]
    low, middle, high = (np.sqrt(power[top + k]) for k in (-1, 0, 1))
    return np.asarray(bin_ / PADDING * (top + 0.5 * (low - high) / (low - 2 * middle + high)))


def _stand_out(t: Array, signal: Array, rest: Array, lines: Array, bin_: float) -> Mask:
    """Which lines are far above the residual around them; at a line's own frequency no residual is left."""
    beside = np.arange(-SURROUNDINGS, SURROUNDINGS + 1)
    around = lines[:, None] + bin_ * beside[np.abs(beside) > APART]
    left = np.abs(_Lines(t, around.ravel()).products(rest)).reshape(around.shape) ** 2
    near = np.nanmedian(np.where(around > 0, left, np.nan), axis=1)
    return np.asarray(np.abs(_Lines(t, lines).products(signal)) ** 2 > STANDS_OUT * near)


def _refined(t: Array, signal: Array, frequency: Array, bin_: float) -> Array:
    """Frequencies after a Gauss-Newton step of at most a quarter of a bin."""
    lines = _Lines(t, frequency)
    weights, rest = lines.fitted(signal)
    size = np.maximum(np.abs(weights), 1e-300) * np.sqrt(np.mean(t**2))  # of a column of the slope, beside the others
    turn = -1j * weights / size

    def forward(z: Spectrum) -> Array:
        own, moved = np.split(z, 2)
        return lines.sum(own) + t * lines.sum(turn * moved.real)

    def backward(rows: Array) -> Spectrum:
        return np.concatenate([lines.products(rows), (turn.conj() * lines.products(t * rows)).real])

    step = _least_squares(forward, backward, rest)[0][frequency.size :].real / size
    return np.asarray(frequency + np.clip(step, -bin_ / 4, bin_ / 4))


class _Lines:
    """The columns cos(w_k t) and sin(w_k t) at regular times; the weights a and b of a pair are one number, a + i b."""

    def __init__(self, t: Array, frequency: Array) -> None:
        self._start = np.exp(-1j * frequency * t[0])
        self._sums = IrregularFourier(frequency * (t[-1] - t[0]) / (t.size - 1), t.size)

    def sum(self, weights: Spectrum) -> Array:
        """Sum of the weighted columns, shape (N,)."""
        return np.asarray(self._sums.over_points(weights * self._start).real)

    def products(self, rows: Array) -> Spectrum:
        """Products of the columns with a signal, shape (K,): that of the cosine plus i times that of the sine."""
        return np.asarray((self._sums.at_points(rows) * self._start).conj())

    def fitted(self, signal: Array) -> tuple[Spectrum, Array]:
        """Least-squares weights, shape (K,), and the residual of the signal, shape (N,)."""
        return _least_squares(self.sum, self.products, signal)


def _least_squares(
    forward: Callable[[Spectrum], Array], backward: Callable[[Array], Spectrum], target: Array
) -> tuple[Spectrum, Array]:
    """Least squares by conjugate gradients: the solution and the residual of the target.

    Lines that are a bin or more apart are nearly orthogonal, so that some twenty steps reach full precision.

    Args:
        forward: Product of the matrix with the unknowns, which are pairs of real numbers.
        backward: Product of its transpose.
        target: Shape (N,).

    Source: M. R. Hestenes, E. Stiefel, J. Res. Natl. Bur. Stand. 49 (1952), pp. 409-436, section 10.
    """
    rest, slope = target, backward(target)
    found, along, power = np.zeros_like(slope), slope, _power(slope)
    enough = CONVERGED**2 * power
    for _ in range(MOST_STEPS):
        if power <= enough:
            break
        moved = forward(along)
        step = power / float(moved @ moved)
        found, rest = found + step * along, rest - step * moved
        slope = backward(rest)
        before, power = power, _power(slope)
        along = slope + power / before * along
    return found, rest


def _power(values: Spectrum) -> float:
    return float(np.vdot(values, values).real)
