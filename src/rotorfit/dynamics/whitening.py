"""Filters data and sensitivities through the disturbance filters of several levels at once.

The likelihood needs the filter at its levels and at small changes of each. These filters differ only in numbers, so
four run in parallel in the lanes of a vector register, and one pass over the blocks serves all. The variables of four
filters for a block lie in one row of an array, in slots of four numbers each: this shows the compiler that nothing
overlaps, so that it vectorises over the four.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.dynamics.disturbance import START_POSITION_VARIANCE, discretize, stationary

WIDTH = 32
"""Largest number of columns filtered together."""

LANES = 4
"""Number of filters in parallel; the last ones are copies where there are fewer."""

PIECE = 1000
"""Number of blocks filtered at a time: the arrays of a piece stay in the processor's cache, whatever the flight's
length."""


@inner()
def _fill_tables(steps: Array, levels: Array, F: Array, Q: Array, out: Array) -> None:
    """Fills F01, F02, F11, F12, F21, F22 and q times Q00, Q01, Q02, Q11, Q12, Q22 for every distinct step and filter.

    Args:
        steps: Shape (U,) [s].
        levels: q, r, alpha, kappa of M filters of one axis, shape (M, 4).
        F: Work space, shape (3, 3).
        Q: Work space, shape (3, 3).
        out: Filled, shape (U, G, 12 LANES), for G groups of parallel filters.
    """
    M, G = levels.shape[0], out.shape[1]
    for u in range(steps.size):
        for n in range(G * LANES):
            m, g, at = min(n, M - 1), n // LANES, n % LANES
            if n == 0 or levels[m, 2] != levels[max(m - 1, 0), 2] or levels[m, 3] != levels[max(m - 1, 0), 3]:
                discretize(levels[m, 2], 0.25 * levels[m, 3] * levels[m, 2] * levels[m, 2], steps[u], F, Q)
            q, place = levels[m, 0], at
            for i in range(2):
                out[u, g, place] = F[0, 1 + i]
                place += LANES
            for i in range(2):
                for j in range(2):
                    out[u, g, place] = F[1 + i, 1 + j]
                    place += LANES
            for i in range(3):
                for j in range(i, 3):
                    out[u, g, place] = q * Q[i, j]
                    place += LANES


@inner()
def _start(row: Array, first: int, levels: Array, g: int) -> None:
    """Fills the prior covariance of an axis before the first block of a segment, for one group."""
    for at in range(LANES):
        variance, rate = stationary(levels[min(g * LANES + at, levels.shape[0] - 1)])
        for i in range(6):
            row[LANES * (first + i) + at] = 0.0
        row[LANES * first + at] = START_POSITION_VARIANCE
        row[LANES * (first + 3) + at] = variance
        row[LANES * (first + 5) + at] = rate


# One axis: slots 0 to 5 hold the upper triangle of the covariance, 6 to 17 the step from `_fill_tables`, 18
# the noise, 19 to 21 the gain, 22 the innovation variance, 23 to 25 the state of the first column, 26 its innovation,
# 27 one over the standard deviation of the innovation.


@inner(fastmath={"contract"})
def _measure(w: Array, share: float, position: float, lanes: int) -> None:
    """Updates one group of filters with a position measurement of noise `share` r, in place."""
    for m in range(lanes):
        p00, p01, p02, p11, p12, p22 = w[m], w[4 + m], w[8 + m], w[12 + m], w[16 + m], w[20 + m]
        S = p00 + share * w[72 + m]
        g0, g1, g2 = p00 / S, p01 / S, p02 / S
        w[m], w[4 + m], w[8 + m] = p00 - g0 * p00, p01 - g0 * p01, p02 - g0 * p02
        w[12 + m], w[16 + m], w[20 + m] = p11 - g1 * p01, p12 - g1 * p02, p22 - g2 * p02
        w[76 + m], w[80 + m], w[84 + m], w[88 + m] = g0, g1, g2, S
        w[92 + m], w[96 + m], w[100 + m], w[104 + m] = g0 * position, g1 * position, g2 * position, position
        w[108 + m] = 1.0 / np.sqrt(S)


@inner(fastmath={"contract"})
def _step_and_measure(w: Array, share: float, position: float, lanes: int) -> None:
    """Propagates one group of filters by a step, P <- F P F^T + Q, and updates it with a position as `_measure`."""
    for m in range(lanes):
        f01, f02, f11, f12, f21, f22 = w[24 + m], w[28 + m], w[32 + m], w[36 + m], w[40 + m], w[44 + m]
        p00, p01, p02, p11, p12, p22 = w[m], w[4 + m], w[8 + m], w[12 + m], w[16 + m], w[20 + m]
        a00, a01, a02 = p00 + f01 * p01 + f02 * p02, p01 + f01 * p11 + f02 * p12, p02 + f01 * p12 + f02 * p22
        a11, a12 = f11 * p11 + f12 * p12, f11 * p12 + f12 * p22
        a21, a22 = f21 * p11 + f22 * p12, f21 * p12 + f22 * p22
        p00 = a00 + a01 * f01 + a02 * f02 + w[48 + m]
        p01 = a01 * f11 + a02 * f12 + w[52 + m]
        p02 = a01 * f21 + a02 * f22 + w[56 + m]
        p11 = a11 * f11 + a12 * f12 + w[60 + m]
        p12 = a11 * f21 + a12 * f22 + w[64 + m]
        p22 = a21 * f21 + a22 * f22 + w[68 + m]
        S = p00 + share * w[72 + m]
        g0, g1, g2 = p00 / S, p01 / S, p02 / S
        w[m], w[4 + m], w[8 + m] = p00 - g0 * p00, p01 - g0 * p01, p02 - g0 * p02
        w[12 + m], w[16 + m], w[20 + m] = p11 - g1 * p01, p12 - g1 * p02, p22 - g2 * p02
        w[76 + m], w[80 + m], w[84 + m], w[88 + m] = g0, g1, g2, S
        s, d = w[96 + m], w[100 + m]
        expected = w[92 + m] + f01 * s + f02 * d
        e = position - expected
        w[92 + m], w[96 + m], w[100 + m] = expected + g0 * e, f11 * s + f12 * d + g1 * e, f21 * s + f22 * d + g2 * e
        w[104 + m], w[108 + m] = e, 1.0 / np.sqrt(S)


@inner(fastmath={"contract"})
def _pass_axis(
    first: int, last: int, step: Any, fresh: Any, table: Array, g: int, at: int, gain: Array, columns: Array, z: Array,
    out: Array,
) -> None:  # fmt: skip
    """Filters the columns from `first` to `last`, at most `WIDTH`, with the filter in one lane of a group.

    Args:
        first: First column.
        last: One past the last.
        step: Shape (B,).
        fresh: Shape (B,).
        table: From `_fill_tables`.
        g: Index of the group.
        at: Index of the lane.
        gain: Gains of the filter, and one over the standard deviation of the innovation, shape (B, 4).
        columns: Shape (B, C).
        z: Work space for the states, 3 slots of `WIDTH` columns each.
        out: Filled with standardised innovations, shape (B, C).
    """
    for i in range(step.size):
        k = step[i]
        f01, f02, f11 = table[k, g, at], table[k, g, 4 + at], table[k, g, 8 + at]
        f12, f21, f22 = table[k, g, 12 + at], table[k, g, 16 + at], table[k, g, 20 + at]
        g0, g1, g2, root = gain[i, 0], gain[i, 1], gain[i, 2], gain[i, 3]
        if fresh[i]:
            for j in range(3 * WIDTH):
                z[j] = 0.0
        for j in range(last - first):
            s, d = z[32 + j], z[64 + j]
            expected = z[j] + f01 * s + f02 * d
            e = columns[i, first + j] - expected
            out[i, first + j] = e * root
            z[j], z[32 + j], z[64 + j] = expected + g0 * e, f11 * s + f12 * d + g1 * e, f21 * s + f22 * d + g2 * e


def _groups(levels: Array) -> int:
    """Number of groups of parallel filters for M filters with levels (M, ...)."""
    return -(-len(levels) // LANES)


Piece = tuple[slice, Array, Array, Array]
"""A stretch of consecutive blocks, and what the filters make of it: see `axis_pieces`. Its arrays are overwritten by
the next piece."""


def _pieces(B: int) -> list[slice]:
    """The stretches of B blocks that are filtered one after the other."""
    return [slice(low, min(low + PIECE, B)) for low in range(0, B, PIECE)]


def axis_pieces(
    steps: Array, step: Indices, count: Array, fresh: Mask, columns: Sequence[Array], levels: Array, few: int
) -> Iterator[Piece]:
    """Filters columns of one axis with M filters. The first column goes side by side with the covariances.

    Args:
        steps: Distinct steps between blocks, shape (U,) [s].
        step: Index of the step that leads to each block, shape (B,).
        count: Poses in each block, shape (B,): the noise of a block is r / count.
        fresh: True where a segment starts and the filters restart, shape (B,).
        columns: Data and sensitivities, in arrays of shape (B, ...) whose last dimensions add up to C.
        levels: q, r, alpha, kappa of each filter, shape (M, 4).
        few: Number of columns for the filters after the first, at least one; the first filters all.

    Yields:
        The blocks of the piece, b of them; innovations over their standard deviation of the first filter, (b, C), and
        of the others, (M - 1, b, few); and the innovation variances, (M, b).
    """
    B, C, M = step.size, sum(part.shape[-1] for part in columns), len(levels)
    b, G, kept, levels = min(B, PIECE), _groups(levels), M if few > 1 else 1, np.ascontiguousarray(levels)
    F, Q, table = np.empty((3, 3)), np.empty((3, 3)), np.empty((steps.size, G, 12 * LANES))
    w, gains, z = np.zeros((G, 28 * LANES)), np.empty((kept, b, 4)), np.empty((kept, -(-C // WIDTH), 3 * WIDTH))
    beside, out, others, variances = np.empty((b, C)), np.empty((b, C)), np.empty((M - 1, b, few)), np.empty((M, b))
    for at in _pieces(B):
        n = at.stop - at.start
        some = np.concatenate([part[at] for part in columns], axis=1, out=beside[:n])
        _whiten_axis(
            steps, step[at], count[at], fresh[at], some, levels, LANES, at.start == 0, F, Q, table, w, gains, z, out,
            others, variances,
        )  # fmt: skip
        yield at, out[:n], others[:, :n], variances[:, :n]


@kernel(fastmath={"contract"})
def _whiten_axis(
    steps: Array, step: Any, count: Array, fresh: Any, columns: Array, levels: Array, lanes: int, first_piece: bool,
    F: Array, Q: Array, table: Array, w: Array, gains: Array, z: Array, out: Array, others: Array, variances: Array,
) -> None:  # fmt: skip
    """The compiled loop over one piece; `table`, `w` and `z` carry over from piece to piece.

    `lanes` is `LANES`, not as a constant, so that loops are vectorised rather than unrolled. Work space is allocated in
    Python, here and elsewhere: a kernel that allocates arrays takes twice as long to compile.
    """
    B, C, M, few, kept = columns.shape[0], columns.shape[1], levels.shape[0], others.shape[2], gains.shape[0]
    if first_piece:
        _fill_tables(steps, levels, F, Q, table)
    for g in range(table.shape[1]):
        row = w[g]
        for m in range(LANES):
            row[18 * LANES + m] = levels[min(g * LANES + m, M - 1), 1]
        for i in range(B):
            if fresh[i]:
                _start(row, g - g, levels, g)  # a zero that is not a literal: a literal would cause another compilation
                _measure(row, 1.0 / count[i], columns[i, 0], lanes)
            else:
                for n in range(12 * LANES):
                    row[6 * LANES + n] = table[step[i], g, n]
                _step_and_measure(row, 1.0 / count[i], columns[i, 0], lanes)
            for m in range(g * LANES, min((g + 1) * LANES, M)):
                at = m % LANES
                variances[m, i], root = row[88 + at], row[108 + at]
                if m == 0:
                    out[i, 0] = row[104 + at] * root
                else:
                    others[m - 1, i, 0] = row[104 + at] * root
                if m < kept:
                    gains[m, i, 0], gains[m, i, 1], gains[m, i, 2] = row[76 + at], row[80 + at], row[84 + at]
                    gains[m, i, 3] = root
    for m in range(kept):
        n = C if m == 0 else few
        for first in range(1, n, WIDTH):
            last, to = min(first + WIDTH, n), out if m == 0 else others[m - 1]
            _pass_axis(
                first, last, step, fresh, table, m // LANES, m % LANES, gains[m], columns, z[m, first // WIDTH], to
            )


# x and y: slots 0 to 5 and 6 to 11 hold the upper triangles of the covariances of x and of y, 12 to 20 that of x with
# y, 21 to 32 and 33 to 44 the step from `_fill_tables`, 45 and 46 the noises, 47 to 52 and 53 to 58 the gains
# of a position of x and of y, 59 and 60 the innovation variances, 61 to 63 and 64 to 66 the state of the first column,
# 67 and 68 its innovations, 69 and 70 one over their standard deviations.


@inner(fastmath={"contract"})
def _turned(a: float, b: float, m: float, n: float, cc: float, ss: float, cs: float) -> Any:
    """Entries i, j of x, of y, of x with y, and entry j, i of x with y, in a frame rotated by the angle of c and s."""
    both, across = cs * (m + n), cs * (b - a)
    return cc * a + ss * b + both, ss * a + cc * b - both, cc * m - ss * n + across, cc * n - ss * m + across


@inner(fastmath={"contract"})
def _turn(w: Array, c: float, s: float, lanes: int) -> None:
    """Rotates the frame of one group of filters, in place."""
    cc, ss, cs = c * c, s * s, c * s
    for m in range(lanes):
        w[m], w[24 + m], w[48 + m], _ = _turned(w[m], w[24 + m], w[48 + m], w[48 + m], cc, ss, cs)
        w[4 + m], w[28 + m], w[52 + m], w[60 + m] = _turned(w[4 + m], w[28 + m], w[52 + m], w[60 + m], cc, ss, cs)
        w[8 + m], w[32 + m], w[56 + m], w[72 + m] = _turned(w[8 + m], w[32 + m], w[56 + m], w[72 + m], cc, ss, cs)
        w[12 + m], w[36 + m], w[64 + m], _ = _turned(w[12 + m], w[36 + m], w[64 + m], w[64 + m], cc, ss, cs)
        w[16 + m], w[40 + m], w[68 + m], w[76 + m] = _turned(w[16 + m], w[40 + m], w[68 + m], w[76 + m], cc, ss, cs)
        w[20 + m], w[44 + m], w[80 + m], _ = _turned(w[20 + m], w[44 + m], w[80 + m], w[80 + m], cc, ss, cs)
        w[244 + m], w[256 + m] = c * w[244 + m] + s * w[256 + m], c * w[256 + m] - s * w[244 + m]
        w[248 + m], w[260 + m] = c * w[248 + m] + s * w[260 + m], c * w[260 + m] - s * w[248 + m]
        w[252 + m], w[264 + m] = c * w[252 + m] + s * w[264 + m], c * w[264 + m] - s * w[252 + m]


@inner(fastmath={"contract"})
def _step_plane(w: Array, lanes: int) -> None:
    """Propagates one group of filters by a step, in place: P <- F P F^T + Q with the transitions of x and of y."""
    for m in range(lanes):
        x01, x02, x11, x12, x21, x22 = w[84 + m], w[88 + m], w[92 + m], w[96 + m], w[100 + m], w[104 + m]
        v, d = w[248 + m], w[252 + m]
        w[244 + m], w[248 + m], w[252 + m] = w[244 + m] + x01 * v + x02 * d, x11 * v + x12 * d, x21 * v + x22 * d
        p00, p01, p02, p11, p12, p22 = w[m], w[4 + m], w[8 + m], w[12 + m], w[16 + m], w[20 + m]
        a00, a01, a02 = p00 + x01 * p01 + x02 * p02, p01 + x01 * p11 + x02 * p12, p02 + x01 * p12 + x02 * p22
        a11, a12 = x11 * p11 + x12 * p12, x11 * p12 + x12 * p22
        a21, a22 = x21 * p11 + x22 * p12, x21 * p12 + x22 * p22
        w[m] = a00 + a01 * x01 + a02 * x02 + w[108 + m]
        w[4 + m] = a01 * x11 + a02 * x12 + w[112 + m]
        w[8 + m] = a01 * x21 + a02 * x22 + w[116 + m]
        w[12 + m] = a11 * x11 + a12 * x12 + w[120 + m]
        w[16 + m] = a11 * x21 + a12 * x22 + w[124 + m]
        w[20 + m] = a21 * x21 + a22 * x22 + w[128 + m]
        y01, y02, y11, y12, y21, y22 = w[132 + m], w[136 + m], w[140 + m], w[144 + m], w[148 + m], w[152 + m]
        v, d = w[260 + m], w[264 + m]
        w[256 + m], w[260 + m], w[264 + m] = w[256 + m] + y01 * v + y02 * d, y11 * v + y12 * d, y21 * v + y22 * d
        p00, p01, p02, p11, p12, p22 = w[24 + m], w[28 + m], w[32 + m], w[36 + m], w[40 + m], w[44 + m]
        a00, a01, a02 = p00 + y01 * p01 + y02 * p02, p01 + y01 * p11 + y02 * p12, p02 + y01 * p12 + y02 * p22
        a11, a12 = y11 * p11 + y12 * p12, y11 * p12 + y12 * p22
        a21, a22 = y21 * p11 + y22 * p12, y21 * p12 + y22 * p22
        w[24 + m] = a00 + a01 * y01 + a02 * y02 + w[156 + m]
        w[28 + m] = a01 * y11 + a02 * y12 + w[160 + m]
        w[32 + m] = a01 * y21 + a02 * y22 + w[164 + m]
        w[36 + m] = a11 * y11 + a12 * y12 + w[168 + m]
        w[40 + m] = a11 * y21 + a12 * y22 + w[172 + m]
        w[44 + m] = a21 * y21 + a22 * y22 + w[176 + m]
        m00, m10, m20 = w[48 + m], w[60 + m], w[72 + m]
        m00, m10, m20 = m00 + x01 * m10 + x02 * m20, x11 * m10 + x12 * m20, x21 * m10 + x22 * m20
        m01, m11, m21 = w[52 + m], w[64 + m], w[76 + m]
        m01, m11, m21 = m01 + x01 * m11 + x02 * m21, x11 * m11 + x12 * m21, x21 * m11 + x22 * m21
        m02, m12, m22 = w[56 + m], w[68 + m], w[80 + m]
        m02, m12, m22 = m02 + x01 * m12 + x02 * m22, x11 * m12 + x12 * m22, x21 * m12 + x22 * m22
        w[48 + m] = m00 + y01 * m01 + y02 * m02
        w[52 + m] = y11 * m01 + y12 * m02
        w[56 + m] = y21 * m01 + y22 * m02
        w[60 + m] = m10 + y01 * m11 + y02 * m12
        w[64 + m] = y11 * m11 + y12 * m12
        w[68 + m] = y21 * m11 + y22 * m12
        w[72 + m] = m20 + y01 * m21 + y02 * m22
        w[76 + m] = y11 * m21 + y12 * m22
        w[80 + m] = y21 * m21 + y22 * m22


@inner(fastmath={"contract"})
def _measure_plane(w: Array, share: float, x: float, y: float, lanes: int) -> None:
    """Updates one group of filters with positions of x, then of y, of noise `share` r, in place."""
    for m in range(lanes):
        S = w[m] + share * w[180 + m]
        x0, x1, x2 = w[m], w[4 + m], w[8 + m]
        y0, y1, y2 = w[48 + m], w[52 + m], w[56 + m]
        gx0, gx1, gx2, gy0, gy1, gy2 = x0 / S, x1 / S, x2 / S, y0 / S, y1 / S, y2 / S
        w[m] -= gx0 * x0
        w[4 + m] -= gx0 * x1
        w[8 + m] -= gx0 * x2
        w[12 + m] -= gx1 * x1
        w[16 + m] -= gx1 * x2
        w[20 + m] -= gx2 * x2
        w[24 + m] -= gy0 * y0
        w[28 + m] -= gy0 * y1
        w[32 + m] -= gy0 * y2
        w[36 + m] -= gy1 * y1
        w[40 + m] -= gy1 * y2
        w[44 + m] -= gy2 * y2
        w[48 + m] -= gx0 * y0
        w[52 + m] -= gx0 * y1
        w[56 + m] -= gx0 * y2
        w[60 + m] -= gx1 * y0
        w[64 + m] -= gx1 * y1
        w[68 + m] -= gx1 * y2
        w[72 + m] -= gx2 * y0
        w[76 + m] -= gx2 * y1
        w[80 + m] -= gx2 * y2
        w[188 + m], w[192 + m], w[196 + m], w[200 + m], w[204 + m], w[208 + m] = gx0, gx1, gx2, gy0, gy1, gy2
        w[236 + m] = S
        e = x - w[244 + m]
        w[244 + m], w[248 + m], w[252 + m] = w[244 + m] + gx0 * e, w[248 + m] + gx1 * e, w[252 + m] + gx2 * e
        w[256 + m], w[260 + m], w[264 + m] = w[256 + m] + gy0 * e, w[260 + m] + gy1 * e, w[264 + m] + gy2 * e
        w[268 + m], w[276 + m] = e, 1.0 / np.sqrt(S)
        S = w[24 + m] + share * w[184 + m]
        x0, x1, x2 = w[48 + m], w[60 + m], w[72 + m]
        y0, y1, y2 = w[24 + m], w[28 + m], w[32 + m]
        gx0, gx1, gx2, gy0, gy1, gy2 = x0 / S, x1 / S, x2 / S, y0 / S, y1 / S, y2 / S
        w[m] -= gx0 * x0
        w[4 + m] -= gx0 * x1
        w[8 + m] -= gx0 * x2
        w[12 + m] -= gx1 * x1
        w[16 + m] -= gx1 * x2
        w[20 + m] -= gx2 * x2
        w[24 + m] -= gy0 * y0
        w[28 + m] -= gy0 * y1
        w[32 + m] -= gy0 * y2
        w[36 + m] -= gy1 * y1
        w[40 + m] -= gy1 * y2
        w[44 + m] -= gy2 * y2
        w[48 + m] -= gx0 * y0
        w[52 + m] -= gx0 * y1
        w[56 + m] -= gx0 * y2
        w[60 + m] -= gx1 * y0
        w[64 + m] -= gx1 * y1
        w[68 + m] -= gx1 * y2
        w[72 + m] -= gx2 * y0
        w[76 + m] -= gx2 * y1
        w[80 + m] -= gx2 * y2
        w[212 + m], w[216 + m], w[220 + m], w[224 + m], w[228 + m], w[232 + m] = gx0, gx1, gx2, gy0, gy1, gy2
        w[240 + m] = S
        e = y - w[256 + m]
        w[244 + m], w[248 + m], w[252 + m] = w[244 + m] + gx0 * e, w[248 + m] + gx1 * e, w[252 + m] + gx2 * e
        w[256 + m], w[260 + m], w[264 + m] = w[256 + m] + gy0 * e, w[260 + m] + gy1 * e, w[264 + m] + gy2 * e
        w[272 + m], w[280 + m] = e, 1.0 / np.sqrt(S)


@inner(fastmath={"contract"})
def _pass_plane(
    first: int, last: int, step: Any, fresh: Any, turn: Array, tx: Array, ty: Array, g: int, at: int, gain: Array,
    along: Array, z: Array, out: Array,
) -> None:  # fmt: skip
    """Filters columns with the filter in one lane of a group: half the turn, the step, the other half, two positions.

    Args:
        first: First column.
        last: One past the last, at most `WIDTH` after it.
        step: Shape (B,).
        fresh: Shape (B,).
        turn: From `turns`, shape (B, 4).
        tx: From `_fill_tables` for x.
        ty: From `_fill_tables` for y.
        g: Index of the group.
        at: Index of the lane.
        gain: Gains of a position of x, of one of y, and one over their standard deviations, shape (B, 14).
        along: Columns in the heading frame, shape (B, 2, C).
        z: The states, 6 slots of `WIDTH` columns each, and work space of 2 more.
        out: Filled with standardised innovations, shape (B, 2, C).
    """
    for i in range(step.size):
        k, c, s = step[i], turn[i, 0], turn[i, 1]
        x01, x02, x11 = tx[k, g, at], tx[k, g, 4 + at], tx[k, g, 8 + at]
        x12, x21, x22 = tx[k, g, 12 + at], tx[k, g, 16 + at], tx[k, g, 20 + at]
        y01, y02, y11 = ty[k, g, at], ty[k, g, 4 + at], ty[k, g, 8 + at]
        y12, y21, y22 = ty[k, g, 12 + at], ty[k, g, 16 + at], ty[k, g, 20 + at]
        g0, g1, g2, g3, g4, g5 = gain[i, 0], gain[i, 1], gain[i, 2], gain[i, 3], gain[i, 4], gain[i, 5]
        h0, h1, h2, h3, h4, h5 = gain[i, 6], gain[i, 7], gain[i, 8], gain[i, 9], gain[i, 10], gain[i, 11]
        root_x, root_y = gain[i, 12], gain[i, 13]
        if fresh[i]:
            for j in range(6 * WIDTH):
                z[j] = 0.0
        for j in range(last - first):  # through slots of `z`: with more arrays the compiler would not vectorise
            z[192 + j], z[224 + j] = along[i, 0, first + j], along[i, 1, first + j]
        for j in range(last - first):
            p, v, a = z[j], z[32 + j], z[64 + j]
            q, u, b = z[96 + j], z[128 + j], z[160 + j]
            p, q, v, u, a, b = c * p + s * q, c * q - s * p, c * v + s * u, c * u - s * v, c * a + s * b, c * b - s * a
            p, v, a = p + x01 * v + x02 * a, x11 * v + x12 * a, x21 * v + x22 * a
            q, u, b = q + y01 * u + y02 * b, y11 * u + y12 * b, y21 * u + y22 * b
            p, q, v, u, a, b = c * p + s * q, c * q - s * p, c * v + s * u, c * u - s * v, c * a + s * b, c * b - s * a
            e = z[192 + j] - p
            f = z[224 + j] - (q + g3 * e)
            z[192 + j], z[224 + j] = e * root_x, f * root_y
            z[j], z[32 + j], z[64 + j] = p + g0 * e + h0 * f, v + g1 * e + h1 * f, a + g2 * e + h2 * f
            z[96 + j], z[128 + j], z[160 + j] = q + g3 * e + h3 * f, u + g4 * e + h4 * f, b + g5 * e + h5 * f
        for j in range(last - first):
            out[i, 0, first + j], out[i, 1, first + j] = z[192 + j], z[224 + j]


def turns(yaw: Array, fresh: Mask) -> Array:
    """Cosine and sine of half the turn that leads to each block, and of the heading there, shape (B, 4)."""
    half = np.where(fresh, 0.0, 0.5 * np.diff(yaw, prepend=yaw[:1]))
    return np.column_stack([np.cos(half), np.sin(half), np.cos(yaw), np.sin(yaw)])


def plane_pieces(
    steps: Array,
    step: Indices,
    count: Array,
    fresh: Mask,
    turn: Array,
    columns: Sequence[Array],
    levels: Array,
    few: int,
) -> Iterator[Piece]:
    """Filters horizontal columns with M six-state filters that rotate with the heading.

    Args:
        steps: Distinct steps between blocks, shape (U,) [s].
        step: Index of the step that leads to each block, shape (B,).
        count: Poses in each block, shape (B,).
        fresh: True where a segment starts, shape (B,).
        turn: From `turns`, shape (B, 4).
        columns: Data and sensitivities in the world frame, in arrays of shape (B, 2, ...) as for `axis_pieces`.
        levels: q, r, alpha, kappa of x and y of the heading frame, of each filter, shape (M, 2, 4).
        few: Number of columns for the filters after the first, at least one; the first filters all.

    Yields:
        The blocks of the piece, b of them; innovations over their standard deviation, forward then left, of the first
        filter, (b, 2, C), and of the others, (M - 1, b, 2, few); and the innovation variances, (M, b, 2).
    """
    B, C, M = step.size, sum(part.shape[-1] for part in columns), len(levels)
    b, G, kept = min(B, PIECE), _groups(levels), M if few > 1 else 1
    levels = np.ascontiguousarray(levels.transpose(1, 0, 2))
    F, Q, tables = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, steps.size, G, 12 * LANES))
    w, gains, z = np.zeros((G, 71 * LANES)), np.empty((kept, b, 14)), np.empty((kept, -(-C // WIDTH), 8 * WIDTH))
    beside, along, out = np.empty((3, b, 2, C))
    others, variances = np.empty((M - 1, b, 2, few)), np.empty((M, b, 2))
    for at in _pieces(B):
        n = at.stop - at.start
        some = np.concatenate([part[at] for part in columns], axis=2, out=beside[:n])
        _whiten_plane(
            steps, step[at], count[at], fresh[at], turn[at], some, levels, LANES, at.start == 0, F, Q, tables, w, gains,
            z, along, out, others, variances,
        )  # fmt: skip
        yield at, out[:n], others[:, :n], variances[:, :n]


@kernel(fastmath={"contract"})
def _whiten_plane(
    steps: Array, step: Any, count: Array, fresh: Any, turn: Array, columns: Array, levels: Array, lanes: int,
    first_piece: bool, F: Array, Q: Array, tables: Array, w: Array, gains: Array, z: Array, along: Array, out: Array,
    others: Array, variances: Array,
) -> None:  # fmt: skip
    """The compiled loop over one piece, like `_whiten_axis`; `levels` has shape (2, M, 4)."""
    B, C, M, few, kept = columns.shape[0], columns.shape[2], levels.shape[1], others.shape[3], gains.shape[0]
    if first_piece:
        for a in range(2):
            _fill_tables(steps, levels[a], F, Q, tables[a])
    tx, ty = tables[0], tables[1]
    for i in range(B):
        c, s = turn[i, 2], turn[i, 3]
        for j in range(C):
            x, y = columns[i, 0, j], columns[i, 1, j]
            along[i, 0, j], along[i, 1, j] = c * x + s * y, c * y - s * x
    for g in range(tx.shape[1]):
        row = w[g]
        for a in range(2):
            for m in range(LANES):
                row[(45 + a) * LANES + m] = levels[a, min(g * LANES + m, M - 1), 1]
        for i in range(B):
            if fresh[i]:
                for n in range(21 * LANES):
                    row[n] = 0.0
                for n in range(61 * LANES, 67 * LANES):
                    row[n] = 0.0
                for a in range(2):
                    _start(row, 6 * a, levels[a], g)
            else:
                for n in range(12 * LANES):
                    row[21 * LANES + n] = tx[step[i], g, n]
                    row[33 * LANES + n] = ty[step[i], g, n]
                c, s = turn[i, 0], turn[i, 1]
                if s != 0.0:
                    _turn(row, c, s, lanes)
                _step_plane(row, lanes)
                if s != 0.0:
                    _turn(row, c, s, lanes)
            _measure_plane(row, 1.0 / count[i], along[i, 0, 0], along[i, 1, 0], lanes)
            for m in range(g * LANES, min((g + 1) * LANES, M)):
                for a in range(2):
                    variances[m, i, a], root = row[(59 + a) * LANES + m % LANES], row[(69 + a) * LANES + m % LANES]
                    if m == 0:
                        out[i, a, 0] = row[(67 + a) * LANES + m % LANES] * root
                    else:
                        others[m - 1, i, a, 0] = row[(67 + a) * LANES + m % LANES] * root
                    if m < kept:
                        gains[m, i, 12 + a] = root
                if m < kept:
                    for n in range(12):
                        gains[m, i, n] = row[(47 + n) * LANES + m % LANES]
    for m in range(kept):
        n = C if m == 0 else few
        for first in range(1, n, WIDTH):
            last, to = min(first + WIDTH, n), out if m == 0 else others[m - 1]
            _pass_plane(
                first, last, step, fresh, turn, tx, ty, m // LANES, m % LANES, gains[m], along, z[m, first // WIDTH], to
            )
