"""Commands between which straight lines were drawn onto the rows of a table, recognised by their shape.

`np.interp`, `interp1` or `interpolate` put commands onto the stamps of poses: three neighbouring rows then lie on one
line, on all axes at once, unless a command comes between them. A vehicle that held each command until the next obeyed
those lines half a period later than the log says, one to which the lines were sent did not: the log cannot tell which.
"""

import numpy as np

from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.flights.stamps import Stamps

STRAIGHT, NEAR = (1e-6, 1e-4, 1e-3), 10
"""Bends over slopes below which rows lie on a line, with ever more rounding of the log; and within how many times as
much most of the small bends must be below it: those of smooth commands have all sizes."""

LEAST_SHARE, FEWEST, PEAK = 0.05, 40, 0.6
"""Share and number of such rows at least, and their share of those with small bends."""

VARIED = 0.5
"""Least number of slopes over that of lines: a stick that is moved at its greatest rate has few."""

FINE, EXACT = 100, 1e-9
"""How many of the smallest bends the median change must hold, and bends over values that are rounding: of coarse
commands changes are often the same by chance."""

REGULAR = 1.6
"""How many times as long as the shortest lines the shortest quarter may be, besides a row: of commands sent by a clock
they are of one length, but where two lie on one line, or no row between two bends is on either."""

DECIMALS = 8
"""Decimals up to which a log counts as rounded."""

SHARP = 5.0
"""Bend over what rounding can do that most bends between lines exceed: else rounding alone bends a smooth command."""

LONGEST = 0.25
"""Longest period that is taken for that of commands [s]: a line of longer duration is a ramp of a planner."""


def period_of_lines(stamps: Stamps, values: Array) -> float:
    """Period of the commands between which lines were drawn [s]; 0 without such lines.

    Lines over time or over the number of the row, in rows at least twice as fast as the commands.

    Args:
        stamps: Increasing, shape (N,) [ns].
        values: Shape (N, K).
    """
    values = values[:, np.ptp(values, axis=0) > 0]
    if len(stamps) < FEWEST or not values.size or _coarse(values):
        return 0.0
    time, grain = (stamps - stamps[0]) / 1e9, _grain(values)
    steps = (time[2:] - time[:-2]) / 2
    steps = np.minimum(steps, 2 * np.median(steps))
    for clock in (time, np.arange(len(stamps), dtype=np.float64)):
        slope = np.diff(values, axis=0) / np.diff(clock)[:, None]
        largest = np.max(np.abs(slope), axis=0)
        scale = largest * np.sqrt(np.mean((slope / largest) ** 2, axis=0))  # squares of tiny ones would be 0
        slope /= scale
        size = np.maximum(np.linalg.norm(slope[1:], axis=1), np.linalg.norm(slope[:-1], axis=1))
        changing = size > 0
        turn = np.linalg.norm(np.diff(slope, axis=0), axis=1)[changing]
        rounding = np.linalg.norm(grain / scale) * (1 / np.diff(clock)[1:] + 1 / np.diff(clock)[:-1])[changing]
        straight = _straight(np.maximum(turn - rounding, 0.0) / size[changing])
        if straight is None or 2 * np.sum(turn[~straight] > SHARP * rounding[~straight]) < np.sum(~straight):
            continue
        begun = straight & ~np.append(False, straight[:-1])
        lines = np.round(slope[1:][changing][begun], 4)
        if len(np.unique(lines, axis=0)) >= VARIED * len(lines):
            on_line = ~changing
            on_line[changing] = straight
            if not _regular(time[1:-1], on_line):
                return 0.0
            moves = _runs(changing).size
            drawn = float(np.sum(steps[changing])) - 2 * moves * float(np.median(steps))
            period = drawn / max(_corners(on_line) - moves, 1)
            return period if 0 < period < LONGEST else 0.0
    return 0.0


def _grain(values: Array) -> Array:
    """Unit of the last decimal to which each column is rounded, shape (K,); 0 where it has more than `DECIMALS`."""
    out = np.zeros(values.shape[1])
    for k, column in enumerate(values.T):
        off = EXACT * float(np.max(np.abs(column)))
        known = (10.0**-d for d in range(DECIMALS + 1) if np.all(np.abs(column - np.round(column, d)) < off))
        out[k] = next(known, 0.0)
    return out


def _coarse(values: Array) -> bool:
    """Whether the axis that changes in most rows is rounded to a share of its usual change."""
    change = np.abs(np.diff(values, axis=0))
    axis = int(np.argmax(np.sum(change > 0, axis=0)))
    bend = np.abs(np.diff(values[:, axis], n=2))
    bend = bend[bend > EXACT * np.max(np.abs(values[:, axis]))]
    moved = change[change[:, axis] > 0, axis]
    return not bend.size or float(np.min(bend)) * FINE > float(np.median(moved))


def _straight(bend: Array) -> Mask | None:
    """Which rows lie on a line with their neighbours, shape (N,); None where smooth commands would bend as little."""
    for most in STRAIGHT:
        straight = bend < most
        count = int(np.sum(straight))
        if count >= max(FEWEST, LEAST_SHARE * bend.size) and count >= PEAK * np.sum(bend < NEAR * most):
            return np.asarray(straight)
    return None


def _regular(time: Array, on_line: Mask) -> bool:
    """Whether the shorter lines are alike, as of commands sent by a clock; a planner's ramps are of all lengths.

    Args:
        time: Of the rows, shape (N,) [s].
        on_line: Which lie on a line with their neighbours, shape (N,).
    """
    corners = time[~on_line & np.append(True, on_line[:-1])]
    if corners.size < FEWEST:
        return False
    short, longer = np.quantile(np.diff(corners), [0.05, 0.25])
    return bool(longer <= REGULAR * short + float(np.median(np.diff(time))))


def _corners(straight: Mask) -> int:
    """Number of commands: one that comes in a row bends the lines there, one between two rows does so in both."""
    return int(np.sum((_runs(~straight) + 1) // 2))


def _runs(mask: Mask) -> Indices:
    """Lengths of the runs in a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return np.asarray(edges[1::2] - edges[::2])
