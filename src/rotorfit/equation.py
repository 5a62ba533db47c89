"""The equation of motion under a low-pass: every term of eq. (5) through the same kernel, stacked into regressors.

    L q'' = g L R u(t - tau) - b L R P R^T q' + c L R 1          P keeps the axis, R turns it into the world

L is any linear operator; the acceleration is never formed, since L's own derivative takes its place where L is smooth.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.frames import Array
from rotorfit.stretch import GRID, Stretch, acceleration_term, command_term, delay_term, trim_term, velocity_term

ROW_EVERY = 10
"""Cells of the grid between the rows of a regression: 20 rows a second, and nothing above 2 Hz passes a low-pass."""

RINGS = 12.0
"""Memories of a filter after which its start is forgotten: e^-36 is left of three equal poles."""


@dataclass(frozen=True)
class LowPass:
    """A linear operator on the terms of the equation.

    Attributes:
        kernel: Filters columns of shape (E, ...) along their first axis, at the edges from `skip` on.
        skip: Edges at the start of a stretch that have no result.
        memory: How long it remembers [s].
        remembers_start: Whether an error of the first velocity rings on: then it gets a column of its own.
    """

    kernel: Callable[[Array], Array]
    skip: int
    memory: float
    remembers_start: bool


def state_variable_filter(poles: Sequence[float]) -> LowPass:
    """The cascade of 1 / (s / p + 1) over the poles p [1/s], sampled on the grid."""
    from scipy.signal import lfilter

    decay = np.exp(-GRID * np.asarray(poles, float))

    def kernel(term: Array) -> Array:
        for e in decay:
            term = lfilter([1 - e], [1.0, -e], term, axis=0)
        return term

    return LowPass(kernel, 0, float(np.sum(1 / np.asarray(poles, float))), True)


def modulating_function(width: float, power: int) -> LowPass:
    """The mean over a window with the weight (1 - (2 s / width)^2)^power, which vanishes smoothly at both ends.

    Under it the second difference of the position is, summed by parts, the position under the second difference of the
    weight: no datum is differentiated.
    """
    from scipy.signal import oaconvolve

    half = round(width / GRID / 2)
    weight = (1 - (np.arange(-half + 1, half) / half) ** 2) ** power
    weight /= weight.sum()

    def kernel(term: Array) -> Array:
        if len(term) < weight.size:
            return np.zeros((0, *term.shape[1:]))
        shape = (weight.size,) + (1,) * (term.ndim - 1)
        return np.asarray(oaconvolve(term, weight.reshape(shape), mode="valid", axes=0))

    return LowPass(kernel, 2 * half - 2, width, False)


@dataclass(frozen=True)
class Layout:
    """Which parameters an equation has: g, tau, b of the active axes, then what is only there to be accounted for.

    Attributes:
        active: Axes that some flight commands.
        trims: Flight and axis of each trim.
        idle: Flight and axis of each damping of a flight that does not command the axis: no estimate, a fit to wind.
        starts: Stretch and world axis of each first velocity.
    """

    active: tuple[int, ...]
    trims: tuple[tuple[int, int], ...]
    idle: tuple[tuple[int, int], ...]
    starts: tuple[tuple[int, int], ...]

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 3 * len(self.active) + len(self.trims) + len(self.idle) + len(self.starts)


def layout_of(parts: Sequence[Stretch], low_pass: LowPass) -> Layout:
    """The parameters of the stretches under a low-pass."""
    K = parts[0].axes
    flights = {part.flight: part for part in parts}
    pairs = [(number, k) for number in flights for k in range(K)]
    starts = [(place, c) for place in range(len(parts)) for c in range(K)] if low_pass.remembers_start else []
    return Layout(
        active=tuple(k for k in range(K) if any(part.commanded[k] for part in parts)),
        trims=tuple(pairs),
        idle=tuple((number, k) for number, k in pairs if not flights[number].commanded[k]),
        starts=tuple(starts),
    )


def input_columns(
    part: Stretch, low_pass: LowPass, layout: Layout, delay: Array, command: Array | None = None
) -> Array:
    """Columns of g of the active axes at the rows, shape (N, C, A).

    Args:
        part: The stretch.
        low_pass: The operator.
        layout: The parameters.
        delay: tau of the active axes, shape (A,) [s].
        command: Other values of the commands, as an instrument has them, shape (M, C).
    """
    terms = [command_term(part, k, delay[a], command) for a, k in enumerate(layout.active)]
    return _rows(np.stack(terms, axis=-1), low_pass)


def delay_columns(
    part: Stretch, low_pass: LowPass, layout: Layout, gain: Array, delay: Array, command: Array | None = None
) -> Array:
    """Columns of tau of the active axes at the rows, scaled by their g, shape (N, C, A); else as `input_columns`."""
    terms = [gain[a] * delay_term(part, k, delay[a], command) for a, k in enumerate(layout.active)]
    return _rows(np.stack(terms, axis=-1), low_pass)


def motion_columns(
    part: Stretch, place: int, low_pass: LowPass, layout: Layout, position: Array | None = None
) -> Array:
    """Columns of b of the active axes, and of all that is accounted for, at the rows, shape (N, C, P - 2 A).

    Args:
        part: The stretch.
        place: Its place among the stretches.
        low_pass: The operator.
        layout: The parameters.
        position: Other positions, as an instrument has them, shape (E + 2, C).
    """
    zero = np.zeros((part.size, part.axes))
    velocity = [-velocity_term(part, k, position) for k in range(part.axes)]
    trim = [trim_term(part, k) for k in range(part.axes)]
    own = [velocity[k] if part.commanded[k] else zero for k in layout.active]
    trims = [trim[k] if number == part.flight else zero for number, k in layout.trims]
    idle = [velocity[k] if number == part.flight else zero for number, k in layout.idle]
    rows = _rows(np.stack([*own, *trims, *idle], axis=-1), low_pass)
    starts = np.zeros((*rows.shape[:2], len(layout.starts)))
    for column, (stretch, c) in enumerate(layout.starts):
        if stretch == place:
            starts[:, c, column] = _ringing(part.size, low_pass)[: len(rows)]
    return np.concatenate([rows, starts], axis=-1)


def _ringing(size: int, low_pass: LowPass) -> Array:
    """What an error of one in the first velocity does to the rows; exactly nothing once it has died away."""
    impulse = np.zeros(min(size, int(RINGS * low_pass.memory / GRID)))
    impulse[0] = 1 / GRID
    out = np.zeros(size)
    out[: impulse.size] = low_pass.kernel(impulse)
    return out[::ROW_EVERY]


def target_rows(part: Stretch, low_pass: LowPass) -> Array:
    """The left-hand side at the rows, shape (N, C)."""
    return _rows(acceleration_term(part), low_pass)


def row_times(part: Stretch, low_pass: LowPass) -> Array:
    """Stamps of the rows, shape (N,) [s]."""
    return part.edge[1:-1][low_pass.skip :: ROW_EVERY]


def _rows(terms: Array, low_pass: LowPass) -> Array:
    return low_pass.kernel(terms)[::ROW_EVERY]
