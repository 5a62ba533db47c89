"""The equation of motion under a low-pass: every term of eq. (5) through the same filter, stacked into regressors.

    L q'' = g L R u(t - tau) - b L R P R^T q' + c L R 1          P keeps the axis, R turns it into the world

L is any linear operator: since every term passes through it, the coefficients do not depend on it. The acceleration is
never computed on its own: where L is smooth, the derivative acts on L instead.

Flights are first cut into stretches and sampled on a fine grid, in world axes. In a cell of the grid only means are
used: of a held, delayed command the exact mean, of the velocity the difference of positions. A velocity along a turning
heading is filtered as the product in eq. (5), R P R^T v, since a filter does not commute with a rotation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.dynamics.first_order_low_pass import first_order_low_pass

GRID = 0.005
"""Step of the grid [s]. A mean over it attenuates a sine by (omega GRID)^2 / 24: 4e-5 at 1 Hz."""

LONGEST_HOLE = 0.25
"""Longest interval between two poses inside a stretch [s]; three sampling periods where that is longer."""

SHORTEST = 1.0
"""Stretches shorter than this are left out [s]."""


@dataclass(frozen=True)
class GridSegment:
    """A stretch of a flight without holes in which every command that may act is known.

    It has E + 1 cells and C world axes (1 or 2). The terms of the equation are evaluated at the E inner edges.

    Attributes:
        flight: Index of the flight.
        edge: Edges of the cells, shape (E + 2,) [s].
        heading: Heading at the middle of each cell, shape (E + 1,) [rad]; 0 for z and yaw.
        position: World position at the edges, less that of the first pose, shape (E + 2, C) [m or rad].
        switch: Stamps of the commands of its segment, and the end of the segment, shape (M + 1,) [s].
        command: Commands of its segment, heading frame, shape (M, C).
        commanded: Which axes have a non-zero command in the flight, shape (C,).
        reference: World setpoint of a position controller, held onto the commands' stamps, shape (M, C); None if there
            is none.
    """

    flight: int
    edge: Array
    heading: Array
    position: Array
    switch: Array
    command: Array
    commanded: tuple[bool, ...]
    reference: Array | None

    @property
    def size(self) -> int:
        """Number of inner edges."""
        return len(self.edge) - 2

    @property
    def axes(self) -> int:
        """Number of world axes."""
        return int(self.position.shape[1])


def stretches(flights: Sequence[Flight], axes: Sequence[str]) -> tuple[GridSegment, ...]:
    """Cuts flights into stretches for z, yaw, or x and y together.

    So that every command that may act is known, a stretch starts no earlier than the longest delay of the search after
    the start of its segment, and ends no later than the end plus the (negative) shortest delay.

    Args:
        flights: The flights.
        axes: `("z",)`, `("yaw",)` or `("x", "y")`.
    """
    found = []
    for number, flight in enumerate(flights):
        t = flight.pose_time
        hole = max(LONGEST_HOLE, 3 * float(np.median(np.diff(t)))) if t.size > 1 else LONGEST_HOLE
        for segment in flight.segments:
            first, last = np.searchsorted(t, [segment.start + DELAY_RANGE[1], segment.end + DELAY_RANGE[0]])
            cuts = [first, *(first + 1 + np.flatnonzero(np.diff(t[first:last]) > hole)), last]
            for low, high in pairwise(cuts):
                if high - low >= 4 and t[high - 1] - t[low] >= SHORTEST:
                    found.append(_stretch(number, flight, segment, slice(int(low), int(high)), axes))
    return tuple(found)


def _stretch(number: int, flight: Flight, segment: Segment, poses: slice, axes: Sequence[str]) -> GridSegment:
    from scipy.interpolate import CubicSpline

    column = [AXES.index(axis) for axis in axes]
    t, pose = flight.pose_time[poses], np.column_stack([flight.position, flight.yaw])[poses]
    edge = t[0] + GRID * np.arange(int((t[-1] - t[0]) / GRID + 1e-6) + 1)
    spline = CubicSpline(t, pose - pose[0])  # passes through every pose, so it only interpolates
    middle = (edge[:-1] + edge[1:]) / 2
    heading = spline(middle)[:, 3] + pose[0, 3] if "x" in axes else np.zeros(middle.size)
    begin, end = np.searchsorted(flight.command_time, [segment.start, segment.end])
    acting = slice(int(begin), int(end))
    return GridSegment(
        flight=number,
        edge=edge,
        heading=heading,
        position=np.ascontiguousarray(spline(edge)[:, column]),
        switch=np.append(flight.command_time[acting], segment.end),
        command=np.ascontiguousarray(flight.command[acting][:, column]),
        commanded=tuple(axis in flight.axes and bool(np.any(flight.command[:, AXES.index(axis)])) for axis in axes),
        reference=_known(flight.reference, acting, column),
    )


def _known(reference: Array | None, acting: slice, column: Sequence[int]) -> Array | None:
    """The reference of these axes, shape (M, C); None where one of them has none."""
    if reference is None or not np.isfinite(reference[acting][:, column]).all():
        return None
    return np.ascontiguousarray(reference[acting][:, column])


def command_term(stretch: GridSegment, k: int, delay: float, command: Array | None = None) -> Array:
    """The command u_k(t - delay) along heading axis k as a world vector at the inner edges, shape (E, C).

    Args:
        stretch: The stretch.
        k: Index of the axis.
        delay: Delay [s].
        command: Values to use instead of the commands, at the same stamps, shape (M, C).
    """
    values = stretch.command if command is None else command
    total = np.concatenate([[0.0], np.cumsum(values[:, k] * np.diff(stretch.switch))])
    mean = np.diff(np.interp(stretch.edge - delay, stretch.switch, total)) / GRID
    return _at_edges(_turned(stretch, k, mean))


def delay_term(stretch: GridSegment, k: int, delay: float, command: Array | None = None) -> Array:
    """Derivative of `command_term` with respect to the delay, shape (E, C) [command/s]."""
    values = stretch.command if command is None else command
    place = np.clip(np.searchsorted(stretch.switch, stretch.edge - delay, side="right") - 1, 0, len(values) - 1)
    return _at_edges(_turned(stretch, k, -np.diff(values[place, k]) / GRID))


def velocity_term(stretch: GridSegment, k: int, position: Array | None = None) -> Array:
    """The velocity along heading axis k as a world vector at the inner edges, shape (E, C) [m/s or rad/s].

    Args:
        stretch: The stretch.
        k: Index of the axis.
        position: Positions to use instead of the measured ones, at the edges of the cells, shape (E + 2, C).
    """
    velocity = np.diff(stretch.position if position is None else position, axis=0) / GRID
    if stretch.axes == 1:
        return _at_edges(velocity)
    c, s = np.cos(stretch.heading), np.sin(stretch.heading)
    along = c * velocity[:, 0] + s * velocity[:, 1] if k == 0 else c * velocity[:, 1] - s * velocity[:, 0]
    return _at_edges(_turned(stretch, k, along))


def trim_term(stretch: GridSegment, k: int) -> Array:
    """A constant of one along heading axis k as a world vector at the inner edges, shape (E, C)."""
    return _at_edges(_turned(stretch, k, np.ones(stretch.heading.size)))


def acceleration_term(stretch: GridSegment) -> Array:
    """Second difference of the position at the inner edges, shape (E, C): only for use under a smooth filter."""
    return np.diff(stretch.position, 2, axis=0) / GRID**2


def _turned(stretch: GridSegment, k: int, along: Array) -> Array:
    """A quantity along heading axis k as world components, shape (E + 1, C)."""
    if stretch.axes == 1:
        return along[:, None]
    c, s = np.cos(stretch.heading), np.sin(stretch.heading)
    return np.stack([c * along, s * along] if k == 0 else [-s * along, c * along], axis=1)


def _at_edges(cells: Array) -> Array:
    return (cells[1:] + cells[:-1]) / 2


ROW_EVERY = 10
"""Number of grid cells per row of a regression: 20 rows per second, and nothing above 2 Hz passes a low-pass."""

RINGS = 12.0
"""Multiple of a filter's memory after which its start is neglected: e^-36 is left of three equal poles."""


@dataclass(frozen=True)
class LowPass:
    """A linear operator on the terms of the equation.

    Attributes:
        kernel: Filters columns of shape (E, ...) along their first axis; the results start at edge `skip`.
        skip: Number of edges at the start of a stretch without a result.
        memory: Time over which the output depends on the input: sum of the time constants, or the window [s].
        remembers_start: Whether an error of the initial velocity persists in the output, so that it needs a column.
    """

    kernel: Callable[[Array], Array]
    skip: int
    memory: float
    remembers_start: bool


def state_variable_filter(poles: Sequence[float]) -> LowPass:
    """The cascade of 1 / (s / p + 1) over the poles p [1/s], sampled on the grid."""
    decay = np.exp(-GRID * np.asarray(poles, float))

    def kernel(term: Array) -> Array:
        for e in decay:
            term = first_order_low_pass(term, float(e))
        return term

    return LowPass(kernel, 0, float(np.sum(1 / np.asarray(poles, float))), True)


def modulating_function(width: float, power: int) -> LowPass:
    """The mean over a window [s] with the weight (1 - (2 s / width)^2)^power, which vanishes smoothly at both ends.

    Summed by parts, the mean of the second difference of the position is that of the position under the second
    difference of the weight: no measurement is differentiated.
    """
    from scipy import fft

    half = round(width / GRID / 2)
    weight = (1 - (np.arange(-half + 1, half) / half) ** 2) ** power
    weight /= weight.sum()

    def kernel(term: Array) -> Array:
        if len(term) < weight.size:
            return np.zeros((0, *term.shape[1:]))
        n = fft.next_fast_len(len(term), real=True)  # what wraps around lies before the first whole window
        spectrum = fft.rfft(weight, n).reshape(-1, *[1] * (term.ndim - 1))
        return np.asarray(fft.irfft(fft.rfft(term, n, axis=0) * spectrum, n, axis=0)[weight.size - 1 : len(term)])

    return LowPass(kernel, 2 * half - 2, width, False)


@dataclass(frozen=True)
class EquationLayout:
    """The parameters of an equation: g, tau, b of the active axes, then the nuisance parameters.

    Attributes:
        active: Axes that some flight commands.
        trims: Flight and axis of each trim.
        idle: Flight and axis of each damping of a flight that does not command the axis: a fit to wind, not reported.
        starts: Stretch and world axis of each initial velocity.
    """

    active: tuple[int, ...]
    trims: tuple[tuple[int, int], ...]
    idle: tuple[tuple[int, int], ...]
    starts: tuple[tuple[int, int], ...]

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 3 * len(self.active) + len(self.trims) + len(self.idle) + len(self.starts)


def layout_of(parts: Sequence[GridSegment], low_pass: LowPass) -> EquationLayout:
    """The parameters of the stretches under a low-pass."""
    K = parts[0].axes
    flights = {part.flight: part for part in parts}
    pairs = [(number, k) for number in flights for k in range(K)]
    starts = [(place, c) for place in range(len(parts)) for c in range(K)] if low_pass.remembers_start else []
    return EquationLayout(
        active=tuple(k for k in range(K) if any(part.commanded[k] for part in parts)),
        trims=tuple(pairs),
        idle=tuple((number, k) for number, k in pairs if not flights[number].commanded[k]),
        starts=tuple(starts),
    )


def input_columns(
    part: GridSegment, low_pass: LowPass, layout: EquationLayout, delay: Array, command: Array | None = None
) -> Array:
    """Columns of g of the active axes, shape (N, C, A).

    Args:
        part: The stretch.
        low_pass: The operator.
        layout: The parameters.
        delay: tau of the active axes, shape (A,) [s].
        command: Values to use instead of the commands, for instruments, shape (M, C).
    """
    terms = [command_term(part, k, delay[a], command) for a, k in enumerate(layout.active)]
    return _rows(np.stack(terms, axis=-1), low_pass)


def delay_columns(
    part: GridSegment,
    low_pass: LowPass,
    layout: EquationLayout,
    gain: Array,
    delay: Array,
    command: Array | None = None,
) -> Array:
    """Columns of tau of the active axes, with the factor g (A,), shape (N, C, A); arguments as for `input_columns`."""
    terms = [gain[a] * delay_term(part, k, delay[a], command) for a, k in enumerate(layout.active)]
    return _rows(np.stack(terms, axis=-1), low_pass)


def motion_columns(
    part: GridSegment, place: int, low_pass: LowPass, layout: EquationLayout, position: Array | None = None
) -> Array:
    """Columns of b of the active axes and of the nuisance parameters, shape (N, C, P - 2 A).

    Args:
        part: The stretch.
        place: Its index among the stretches.
        low_pass: The operator.
        layout: The parameters.
        position: Values to use instead of the positions, for instruments, shape (E + 2, C).
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
    """Effect of a unit error of the initial velocity on the rows; exactly zero after `RINGS` memories of the filter."""
    impulse = np.zeros(min(size, int(RINGS * low_pass.memory / GRID)))
    impulse[0] = 1 / GRID
    out = np.zeros(size)
    out[: impulse.size] = low_pass.kernel(impulse)
    return out[::ROW_EVERY]


def target_rows(part: GridSegment, low_pass: LowPass) -> Array:
    """Rows of the left-hand side, shape (N, C)."""
    return _rows(acceleration_term(part), low_pass)


def row_times(part: GridSegment, low_pass: LowPass) -> Array:
    """Stamps of the rows, shape (N,) [s]."""
    return part.edge[1:-1][low_pass.skip :: ROW_EVERY]


def _rows(terms: Array, low_pass: LowPass) -> Array:
    return low_pass.kernel(terms)[::ROW_EVERY]
