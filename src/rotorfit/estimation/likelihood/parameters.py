"""Point: parameters of the likelihood, as named arrays and as one flat vector, with the ranges of the search.

Coefficients enter as (g, log b, tau), so the damping is positive by construction.
"""

import functools
import itertools
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import DELAY_RANGE, FIRST_ORDER_DELAY, LAG, Extra, Measured, Structure, law_of, level_range

DAMPING_RANGE = (1e-3, 100.0)
"""Range of dampings that is searched [1/s]."""


@dataclass(frozen=True)
class Point:
    """A point of the parameter space of K axes and F flights.

    Attributes:
        gain: g, shape (K,) [m/s^2 or rad/s^2 per unit of the command].
        log_damping: log b, b in 1/s, shape (K,).
        delay: tau, shape (K,) [s].
        trim: c in the heading frame, shape (F, K) [m/s^2 or rad/s^2].
        start: Velocity at the start of each segment, over the segments of all flights in turn, shape (S, K) [m/s or
            rad/s]; world frame for x with y.
        levels: Logarithms of q, r, alpha, kappa, shape (K, L): L = 4; or 5, the last being r_v, where position and
            velocity are measured. Where only a velocity is, r_v is in the place of r.
        structures: Structure of each axis; empty if all have the first-order law with a delay.
        extra: Coordinates of the further parameters, shape (E, K); E is that of the axis with the most of them, and
            entries that an axis does not have are ignored.
        measured: Kind of measurement to which the levels belong.
    """

    gain: Array
    log_damping: Array
    delay: Array
    trim: Array
    start: Array
    levels: Array
    structures: tuple[Structure, ...] = ()
    extra: Array = field(default_factory=lambda: np.empty((0, 1)))
    measured: Measured = "position"

    def flat(self) -> Array:
        """One vector of g of all axes, log b, tau, further parameters, trims, start velocities, levels: (n + L K,)."""
        return self._flat.copy()

    @cached_property
    def _flat(self) -> Array:
        parts = (self.gain, self.log_damping, self.delay, self.extra, self.trim, self.start, self.levels)
        return np.concatenate([part.ravel() for part in parts])

    @property
    def coefficients(self) -> int:
        """Number of parameters before the trims: 3 + E per axis."""
        return 3 * self.gain.size + self.extra.size

    @property
    def n(self) -> int:
        """Number of parameters before the levels."""
        return self.coefficients + self.trim.size + self.start.size

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the search, in the order of `flat`."""
        others = self.trim.size + self.start.size
        return _bounds(self.gain.size, self.structures, len(self.extra), others, self.measured)

    def moved(self, step: Array) -> "Point":
        """The point plus a step in the order of `flat`, clipped to the bounds of the search.

        A lag, whose coordinate is its logarithm, goes by its own slope: what flights determine best is the sum of delay
        and lag, and a step that keeps this sum keeps it however long it is.
        """
        values = self.flat() + step
        for at in _lags(self.structures):
            share = step[at]
            values[at] += (np.log1p(share) if share > -0.5 else 2.0 * share + 1.0 - np.log(2.0)) - share
        return self.with_flat(np.clip(values, *self.bounds()))

    def held_at(self, index: int, target: float) -> "Point":
        """The point with one parameter of `flat` at a target; with a lag on the input, its sum with the delay stays."""
        values, K = self.flat(), self.gain.size
        if index in _lags(self.structures):
            values[2 * K + index % K] += np.exp(values[index]) - np.exp(target)
        values[index] = target
        return self.with_flat(np.clip(values, *self.bounds()))

    def reach(self, step: Array) -> float:
        """Largest share of a step, at most 1, that stays inside the bounds; parameters already at one are ignored."""
        value, (low, high) = self.flat(), self.bounds()
        room = np.where(step > 0, high - value, value - low)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where((step != 0) & (room > 0), room / np.abs(step), np.inf)
        return float(min(1.0, share.min()))

    def with_flat(self, values: Array) -> "Point":
        """The point with all parameters replaced, in the order of `flat`."""
        K = self.gain.size
        sizes = (0, K, K, K, self.extra.size, self.trim.size, self.start.size, self.levels.size)
        ends = itertools.pairwise(itertools.accumulate(sizes))
        gain, log_damping, delay, extra, trim, start, levels = (values[low:high] for low, high in ends)
        return Point(
            gain, log_damping, delay, trim.reshape(-1, K), start.reshape(-1, K), levels.reshape(K, -1),
            self.structures, extra.reshape(self.extra.shape), self.measured,
        )  # fmt: skip

    def place(self, name: str, k: int) -> int:
        """Index of a coefficient or further parameter of axis k in `flat`."""
        K = self.gain.size
        if name in ("input", "damping", "delay"):
            return ("input", "damping", "delay").index(name) * K + k
        return (3 + [extra.name for extra in self.structures[k].extras].index(name)) * K + k

    def extras(self, k: int) -> tuple[Extra, ...]:
        """Further parameters of the law of axis k."""
        return self.structures[k].extras if self.structures else ()

    def extra_values(self, k: int) -> dict[str, float]:
        """Further parameters of axis k by name."""
        return {extra.name: extra.value(self.extra[e, k]) for e, extra in enumerate(self.extras(k))}

    @property
    def laws(self) -> Array:
        """The general law of each axis without trim, shape (K, LAW_SIZE)."""
        structures = self.structures or (FIRST_ORDER_DELAY,) * self.gain.size
        coefficients = zip(structures, self.gain, np.exp(self.log_damping), self.delay, strict=True)
        return np.array([law_of(*each, self.extra_values(k)) for k, each in enumerate(coefficients)])


@functools.cache
def _lags(structures: tuple[Structure, ...]) -> tuple[int, ...]:
    """Indices in `flat` of the lags on the input of axes with these structures."""
    return tuple(
        (3 + e) * len(structures) + k
        for k, law in enumerate(structures)
        for e, one in enumerate(law.extras)
        if one.place == LAG and law.order == 1
    )


@functools.cache
def _bounds(K: int, structures: tuple[Structure, ...], E: int, others: int, measured: Measured) -> tuple[Array, Array]:
    """Bounds of a point with K axes, E further parameters, and `others` trims and start velocities."""
    extra = np.tile(np.array([-np.inf, np.inf]), (E, K, 1))
    for k, structure in enumerate(structures):
        for e, one in enumerate(structure.extras):
            extra[e, k] = one.coordinate(one.low), one.coordinate(one.high)
    low, high = (
        np.concatenate(
            [
                np.full(K, sign * np.inf),
                np.full(K, np.log(DAMPING_RANGE)[end]),
                np.full(K, DELAY_RANGE[end]),
                extra[:, :, end].ravel(),
                np.full(others, sign * np.inf),
                np.tile(level_range(measured)[:, end], K),
            ]
        )
        for end, sign in ((0, -1.0), (1, 1.0))
    )
    return low, high
