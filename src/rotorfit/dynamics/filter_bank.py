"""A bank of disturbance filters that adapts to the levels of the filtered flight, causally.

The levels of a calm flight mislead in a gusty one: the filter follows the gusts too slowly. So filters with other
levels, the members, run beside the one with the model's own levels, and their estimates are averaged, axis by axis,
with weights from the past alone:

    log w = log w_0 + eta log L - n / 2 log E

E is the mean square of a member's prediction errors 0.5 s ahead, over n such stretches; L is the likelihood of its
innovations; the past is forgotten with `MEMORY`. E dominates because prediction is the purpose: with a slightly wrong
law, or pose noise that is not white, the one-step likelihood prefers levels that predict worse. The likelihood has a
small weight (eta), but reacts at once to levels that are far off, and to an error caused by a single false pose.

A member knows its levels up to one scale sigma^2 per axis, which it learns from its innovations. The scale enters the
likelihood and the predicted error, not the prediction. Call `start_bank`, then for each stamp `move`, `judge`, `take`
and `probe`: the state only moves forwards in time.

Source: D. T. Magill, IEEE Trans. Automatic Control 10 (1965), pp. 434-439, for the bank; A. E. Raftery, M. Karny,
P. Ettler, Technometrics 52 (2010), pp. 52-66, for forgetting; J. Geweke, G. Amisano, J. Econometrics 164 (2011), pp.
130-141, for weights by past predictions where every member is wrong; M. West, J. Harrison, Bayesian Forecasting and
Dynamic Models (1997), ch. 10.8, for the scale.
"""

from typing import Any, NamedTuple

import numpy as np

from rotorfit.core.compiled import inner, kernel
from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.dynamics.disturbance import (
    axis_start,
    fill_step_tables,
)

POWERS = 8.0 ** np.array([0, -1, 1, -2, 2, -3, 3, -4, 4])
"""Factors on the power of the wind at equal pose noise."""

RATES = np.array([1.0, 0.4, 2.5])
"""Factors on the damping of the wind; the power scales with their square, as it does over recorded flights."""

MEMORY = 20.0
"""Time after which the weight of the past has decayed to 1/e [s]."""

OWN_SHARE = 0.5
"""Prior weight of the model's own levels."""

AHEAD = 0.5
"""Horizon at which members are judged [s]; at longer ones there are too few errors in a minute to learn from."""

EVERY = 0.1
"""Time between the predictions that are judged [s]."""

PENDING = 8
"""Largest number of predictions waiting to be judged."""

SHARPNESS = 2.0
"""Number of independent errors that a stretch of `AHEAD` counts as: members err alike, so differences are surer."""

TEMPER = 0.02
"""eta."""

SCALE_FREEDOM = 30.0
"""Number of innovations that the scale of the model's own levels counts as (prior degrees of freedom)."""


_ROOT_HALF = int(np.float64(0.5**0.5).view(np.int64))

_LOG_2 = float(np.log(2.0))

LANES = 32
"""Width of a slot, and largest number of members. The members are side by side: a slot holds one number of each."""

_VECTOR = 4
"""Members are filled up with copies to a multiple of this, so that no loop over them has a remainder."""

AXIS = 23
"""Slots of one axis."""

_STEP, _NOISE, POWER, NOISE, SQUARES, LIKELIHOOD, ERROR = 6, 12, 18, 19, 20, 21, 22
"""Slots within those of an axis; first the upper triangle of the covariance of its disturbance, at the member's levels.

F01, F02, F11, F12, F21, F22 for the present step; Q00, Q01, Q02, Q11, Q12, Q22 for a unit power; q, r, the sum of
squares of the scale, log L, and the sum of the squared errors of E."""

_ACROSS = 2 * AXIS
"""First slot of the covariance of x with y, row by row."""

KNOWN, SPREAD = _ACROSS + 9, _ACROSS + 13
"""First slots of the estimates of two trims (heading frame) and two start velocities (world), and of the upper triangle
of their covariance, at the member's levels."""

_CROSS, _GAIN, _OFF, _VARIANCE = SPREAD + 10, SPREAD + 16, SPREAD + 22, SPREAD + 27
"""Work space of an update: covariance with the measured quantity, gain, innovations of the columns, variance of the
innovation."""

SLOTS = _VARIANCE + 1

_X00, _X01, _X02, _X11, _X12, _X22 = (LANES * i for i in range(6))
_Y00, _Y01, _Y02, _Y11, _Y12, _Y22 = (LANES * (AXIS + i) for i in range(6))
_C00, _C01, _C02, _C10, _C11, _C12, _C20, _C21, _C22 = (LANES * (_ACROSS + i) for i in range(9))

ROWS = np.array([
    [0, 1, 2, 46, 47, 48], [1, 3, 4, 49, 50, 51], [2, 4, 5, 52, 53, 54],
    [46, 49, 52, 23, 24, 25], [47, 50, 53, 24, 26, 27], [48, 51, 54, 25, 27, 28],
])  # fmt: skip
"""Slots of the rows of the covariance."""

UPPER = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])
"""Places of the rows of `SPREAD`."""

COLUMNS_FILTERED = 5
"""Filtered beside each other: data minus driven response, two unit trims and two unit start velocities."""


class Bank(NamedTuple):
    """M members before the next stamp; arrays are changed in place.

    Single arrays with constant offsets show the compiler that nothing overlaps, so that it vectorises over the members.
    Where an offset varies, it vectorises over the last index of a second view of the same memory.

    Attributes:
        members: M.
        flat: Slots of members, shape (SLOTS * LANES,).
        slots: The same memory, shape (SLOTS, LANES).
        axes: The slots of the axes, shape (2, AXIS * LANES).
        winds: Disturbance n, s, s' of both axes: the filtered columns, see `COLUMNS_FILTERED`, then the predictions
            that wait to be judged, carried on to now, shape (COLUMNS_FILTERED + PENDING, 6 * LANES).
        wind: The same memory, shape (COLUMNS_FILTERED + PENDING, 6, LANES).
        believed: `KNOWN` at the time of those predictions, shape (PENDING, 4, LANES).
        freedom: Number of squares of the scale of each axis, shape (2,).
        errors: Number of errors of E, shape (2,).
        due: Time of judgement, shape (PENDING,) [s].
        judged: Whether it has been judged on each axis, shape (PENDING, 2).
        probed: Time of the last prediction, shape (1,) [s].
        of: 1 for members of the first, second, third class, else 0, shape (3, LANES).
        loaded: Index of the step in the slots, shape (1,).
    """

    members: int
    flat: Array
    slots: Array
    axes: Array
    winds: Array
    wind: Array
    believed: Array
    freedom: Array
    errors: Array
    due: Array
    judged: Mask
    probed: Array
    of: Array
    loaded: Indices


def bank_levels(levels: Array, adapt: bool) -> Array:
    """Levels of the members, grouped in classes of equal wind damping, the model's own first.

    Args:
        levels: q, r, alpha, kappa of two axes, shape (2, 4).
        adapt: False for only the model's own levels.

    Returns:
        Shape (A, G, 2, 4): A classes of G members.
    """
    if not adapt:
        return levels[None, None].copy()
    out: Array = np.tile(levels, (RATES.size, POWERS.size, 1, 1))
    out[..., 0] *= POWERS[None, :, None] * RATES[:, None, None] ** 2
    out[..., 2] *= RATES[:, None, None]
    return out


def start_bank(levels: Array, prior: Array) -> Bank:
    """A bank before the first stamp. Arrays are allocated in Python: in a kernel each takes time to compile.

    Args:
        levels: From `bank_levels`, shape (A, G, 2, 4).
        prior: Variances of two trims and two start velocities, shape (4,).
    """
    members = levels.reshape(-1, *levels.shape[2:])
    slots, wind = np.zeros((SLOTS, LANES)), np.zeros((COLUMNS_FILTERED + PENDING, 6, LANES))
    for m in range(LANES):
        level = members[min(m, len(members) - 1)]
        for a in range(2):
            covariance = np.zeros((3, 3))
            axis_start(covariance, level[a])
            slots[AXIS * a : AXIS * a + 6, m] = covariance[np.triu_indices(3)]
            slots[AXIS * a + POWER, m], slots[AXIS * a + NOISE, m] = level[a, :2]
    slots[SPREAD + np.diag(UPPER)] = prior[:, None]
    slots[[SQUARES, AXIS + SQUARES]] = SCALE_FREEDOM
    return Bank(
        members=len(members),
        flat=slots.reshape(-1),
        slots=slots,
        axes=slots[:_ACROSS].reshape(2, -1),
        winds=wind.reshape(len(wind), -1),
        wind=wind,
        believed=np.zeros((PENDING, 4, LANES)),
        freedom=np.full(2, SCALE_FREEDOM),
        errors=np.zeros(2),
        due=np.zeros(PENDING),
        judged=np.ones((PENDING, 2), np.bool_),
        probed=np.full(1, -np.inf),
        of=(np.minimum(np.arange(LANES) // levels.shape[1], 2) == np.arange(3)[:, None]).astype(float),
        loaded=np.full(1, -1),
    )


def bank_tables(steps: Array, levels: Array) -> Array:
    """F01, F02, F11, F12, F21, F22 and Q00, Q01, Q02, Q11, Q12, Q22, for a unit power, of every distinct step and axis.

    Args:
        steps: Shape (U,) [s].
        levels: From `bank_levels`, shape (A, G, 2, 4).

    Returns:
        Shape (U, 24, A): the axes follow each other, the classes come last.
    """
    A = levels.shape[0]
    out, F, Q = np.empty((steps.size, 24, A)), *np.zeros((2, steps.size, 3, 3))
    for g, a in np.ndindex(A, 2):
        fill_step_tables(steps, levels[g, 0, a, 2], levels[g, 0, a, 3], F, Q)
        first = 12 * a
        out[:, first : first + 2, g], out[:, first + 2 : first + 6, g] = F[:, 0, 1:], F[:, 1:, 1:].reshape(-1, 4)
        out[:, first + 6 : first + 12, g] = Q[:, *np.triu_indices(3)]
    return out


@inner()
def _load(slots: Array, of: Array, table: Array, k: int, lanes: int) -> None:
    """Fills the slots with step k of a table; see `Bank.of`."""
    last = table.shape[2] - 1
    for i in range(table.shape[1]):
        place = _STEP + i if i < 12 else AXIS + _STEP + i - 12
        x, y, z = table[k, i, 0], table[k, i, min(1, last)], table[k, i, last]
        for m in range(lanes):
            slots[place, m] = of[0, m] * x + of[1, m] * y + of[2, m] * z


@inner(fastmath={"contract"})
def _turned(a: float, b: float, m: float, n: float, cc: float, ss: float, cs: float) -> Any:
    """Entries i, j of x, of y, of x with y, and entry j, i of x with y, in a frame rotated by the angle of c and s."""
    both, across = cs * (m + n), cs * (b - a)
    return cc * a + ss * b + both, ss * a + cc * b - both, cc * m - ss * n + across, cc * n - ss * m + across


@inner(fastmath={"contract"})
def _turn_covariance(w: Array, c: float, s: float, lanes: int) -> None:
    """Rotates the frame of the covariances, in place."""
    cc, ss, cs = c * c, s * s, c * s
    for m in range(lanes):
        x, y, a, b = _X00 + m, _Y00 + m, _C00 + m, _C00 + m
        w[x], w[y], w[a], _ = _turned(w[x], w[y], w[a], w[b], cc, ss, cs)
        x, y, a, b = _X01 + m, _Y01 + m, _C01 + m, _C10 + m
        w[x], w[y], w[a], w[b] = _turned(w[x], w[y], w[a], w[b], cc, ss, cs)
        x, y, a, b = _X02 + m, _Y02 + m, _C02 + m, _C20 + m
        w[x], w[y], w[a], w[b] = _turned(w[x], w[y], w[a], w[b], cc, ss, cs)
        x, y, a, b = _X11 + m, _Y11 + m, _C11 + m, _C11 + m
        w[x], w[y], w[a], _ = _turned(w[x], w[y], w[a], w[b], cc, ss, cs)
        x, y, a, b = _X12 + m, _Y12 + m, _C12 + m, _C21 + m
        w[x], w[y], w[a], w[b] = _turned(w[x], w[y], w[a], w[b], cc, ss, cs)
        x, y, a, b = _X22 + m, _Y22 + m, _C22 + m, _C22 + m
        w[x], w[y], w[a], _ = _turned(w[x], w[y], w[a], w[b], cc, ss, cs)


@inner(fastmath={"contract"})
def _six(w: Array, at: int) -> Any:
    """Six consecutive slots of one member: a transition F01, F02, F11, F12, F21, F22, or an upper triangle."""
    return w[at], w[LANES + at], w[2 * LANES + at], w[3 * LANES + at], w[4 * LANES + at], w[5 * LANES + at]


@inner(fastmath={"contract"})
def _step_covariance(w: Array, axes: Array, lanes: int) -> None:
    """P <- F P F^T + q Q, in place."""
    for a in range(2):
        for m in range(lanes):
            p00, p01, p02 = axes[a, m], axes[a, LANES + m], axes[a, 2 * LANES + m]
            p11, p12, p22 = axes[a, 3 * LANES + m], axes[a, 4 * LANES + m], axes[a, 5 * LANES + m]
            f01, f02, f11 = axes[a, 6 * LANES + m], axes[a, 7 * LANES + m], axes[a, 8 * LANES + m]
            f12, f21, f22 = axes[a, 9 * LANES + m], axes[a, 10 * LANES + m], axes[a, 11 * LANES + m]
            q = axes[a, POWER * LANES + m]
            a00, a01, a02 = p00 + f01 * p01 + f02 * p02, p01 + f01 * p11 + f02 * p12, p02 + f01 * p12 + f02 * p22
            a11, a12 = f11 * p11 + f12 * p12, f11 * p12 + f12 * p22
            a21, a22 = f21 * p11 + f22 * p12, f21 * p12 + f22 * p22
            axes[a, m] = a00 + a01 * f01 + a02 * f02 + q * axes[a, 12 * LANES + m]
            axes[a, LANES + m] = a01 * f11 + a02 * f12 + q * axes[a, 13 * LANES + m]
            axes[a, 2 * LANES + m] = a01 * f21 + a02 * f22 + q * axes[a, 14 * LANES + m]
            axes[a, 3 * LANES + m] = a11 * f11 + a12 * f12 + q * axes[a, 15 * LANES + m]
            axes[a, 4 * LANES + m] = a11 * f21 + a12 * f22 + q * axes[a, 16 * LANES + m]
            axes[a, 5 * LANES + m] = a21 * f21 + a22 * f22 + q * axes[a, 17 * LANES + m]
    for m in range(lanes):
        x01, x02, x11, x12, x21, x22 = _six(w, _STEP * LANES + m)
        y01, y02, y11, y12, y21, y22 = _six(w, (AXIS + _STEP) * LANES + m)
        p00, p10, p20 = w[_C00 + m], w[_C10 + m], w[_C20 + m]
        p00, p10, p20 = p00 + x01 * p10 + x02 * p20, x11 * p10 + x12 * p20, x21 * p10 + x22 * p20
        p01, p11, p21 = w[_C01 + m], w[_C11 + m], w[_C21 + m]
        p01, p11, p21 = p01 + x01 * p11 + x02 * p21, x11 * p11 + x12 * p21, x21 * p11 + x22 * p21
        p02, p12, p22 = w[_C02 + m], w[_C12 + m], w[_C22 + m]
        p02, p12, p22 = p02 + x01 * p12 + x02 * p22, x11 * p12 + x12 * p22, x21 * p12 + x22 * p22
        w[_C00 + m] = p00 + y01 * p01 + y02 * p02
        w[_C01 + m] = y11 * p01 + y12 * p02
        w[_C02 + m] = y21 * p01 + y22 * p02
        w[_C10 + m] = p10 + y01 * p11 + y02 * p12
        w[_C11 + m] = y11 * p11 + y12 * p12
        w[_C12 + m] = y21 * p11 + y22 * p12
        w[_C20 + m] = p20 + y01 * p21 + y02 * p22
        w[_C21 + m] = y11 * p21 + y12 * p22
        w[_C22 + m] = y21 * p21 + y22 * p22


@inner(fastmath={"contract"})
def _fade(z: Array, j: int, w: Array, c: float, s: float, lanes: int) -> None:
    """Propagates the disturbances z[j] (6 * LANES,) by the step in the slots; c and s are for half the turn."""
    for m in range(lanes):
        n, v, a = z[j, m], z[j, LANES + m], z[j, 2 * LANES + m]
        N, V, A = z[j, 3 * LANES + m], z[j, 4 * LANES + m], z[j, 5 * LANES + m]
        n, v, a, N, V, A = c * n + s * N, c * v + s * V, c * a + s * A, c * N - s * n, c * V - s * v, c * A - s * a
        x01, x02, x11, x12, x21, x22 = _six(w, _STEP * LANES + m)
        y01, y02, y11, y12, y21, y22 = _six(w, (AXIS + _STEP) * LANES + m)
        n, v, a = n + x01 * v + x02 * a, x11 * v + x12 * a, x21 * v + x22 * a
        N, V, A = N + y01 * V + y02 * A, y11 * V + y12 * A, y21 * V + y22 * A
        z[j, m], z[j, LANES + m], z[j, 2 * LANES + m] = c * n + s * N, c * v + s * V, c * a + s * A
        z[j, 3 * LANES + m], z[j, 4 * LANES + m], z[j, 5 * LANES + m] = c * N - s * n, c * V - s * v, c * A - s * a


@inner(fastmath={"contract"})
def move(bank: Any, table: Array, k: int, turn: float, dt: float) -> None:
    """Propagates a bank by one step of dt [s], index k in the table, while the heading turns by `turn` [rad]."""
    w, axes, judged, lanes = bank.flat, bank.axes, bank.judged, _lanes(bank.members)
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    kept = np.exp(-dt / MEMORY)
    if bank.loaded[0] != k:
        _load(bank.slots, bank.of, table, k, lanes)
        bank.loaded[0] = k
    if s != 0.0:
        _turn_covariance(w, c, s, lanes)
    _step_covariance(w, axes, lanes)
    if s != 0.0:
        _turn_covariance(w, c, s, lanes)
    for j in range(COLUMNS_FILTERED + PENDING):
        if j < COLUMNS_FILTERED or not (judged[j - COLUMNS_FILTERED, 0] and judged[j - COLUMNS_FILTERED, 1]):
            _fade(bank.winds, j, w, c, s, lanes)
    for a in range(2):
        for m in range(lanes):
            squares = axes[a, SQUARES * LANES + m]
            axes[a, SQUARES * LANES + m] = SCALE_FREEDOM + kept * (squares - SCALE_FREEDOM)
            axes[a, LIKELIHOOD * LANES + m] *= kept
            axes[a, ERROR * LANES + m] *= kept
        bank.freedom[a] = SCALE_FREEDOM + kept * (bank.freedom[a] - SCALE_FREEDOM)
        bank.errors[a] *= kept


@inner()
def _lanes(members: int) -> int:
    return -(-members // _VECTOR) * _VECTOR


@inner(fastmath={"contract"})
def judge(bank: Any, axis: int, rate: Any, measured: Array, t: float) -> None:
    """Compares predictions that are due at time t [s] with the measurement; arguments as for `take`."""
    at = 3 * axis + (1 if rate else 0)
    judged, due, wind, believed, slots = bank.judged, bank.due, bank.wind, bank.believed, bank.slots
    for i in range(PENDING):
        if judged[i, axis] or t < due[i]:
            continue
        judged[i, axis] = True
        bank.errors[axis] += 1.0
        for m in range(bank.members):
            e = measured[0] - wind[COLUMNS_FILTERED + i, at, m]
            for j in range(4):
                e -= believed[i, j, m] * measured[1 + j]
            slots[AXIS * axis + ERROR, m] += e * e


@inner(fastmath={"contract"})
def take(bank: Any, axis: int, rate: Any, measured: Array) -> None:
    """Updates all members with a measurement of one axis.

    Args:
        bank: Changed in place.
        axis: 0 or 1.
        rate: Whether a velocity was measured, else a position.
        measured: Along the axis: data minus driven response, then the response to two unit trims and two unit start
            velocities, shape (5,).
    """
    at = 3 * axis + (1 if rate else 0)
    w, slots, axes, wind, winds = bank.flat, bank.slots, bank.axes, bank.wind, bank.winds
    lanes = _lanes(bank.members)
    for i in range(6):
        source = ROWS[at, i]
        for m in range(lanes):
            slots[_CROSS + i, m] = slots[source, m]
    for m in range(lanes):
        slots[_VARIANCE, m] = slots[_CROSS + at, m] + slots[AXIS * axis + NOISE, m]
    for j in range(COLUMNS_FILTERED):
        for m in range(lanes):
            slots[_OFF + j, m] = measured[j] - wind[j, at, m]
    _correct(w, lanes)
    for j in range(COLUMNS_FILTERED):
        for m in range(lanes):
            e = slots[_OFF + j, m]
            winds[j, m] += w[_GAIN * LANES + m] * e
            winds[j, LANES + m] += w[(_GAIN + 1) * LANES + m] * e
            winds[j, 2 * LANES + m] += w[(_GAIN + 2) * LANES + m] * e
            winds[j, 3 * LANES + m] += w[(_GAIN + 3) * LANES + m] * e
            winds[j, 4 * LANES + m] += w[(_GAIN + 4) * LANES + m] * e
            winds[j, 5 * LANES + m] += w[(_GAIN + 5) * LANES + m] * e
    _learn(w, lanes)
    n = bank.freedom[axis]
    for m in range(lanes):
        variance, square, squares = w[_VARIANCE * LANES + m], w[_OFF * LANES + m], axes[axis, SQUARES * LANES + m]
        # Student's t with n degrees of freedom; the difference of its normalisation from a Gaussian's is common to all.
        common, own = logarithm(variance * squares / n), logarithm(1.0 + square / squares)
        axes[axis, LIKELIHOOD * LANES + m] -= 0.5 * common + 0.5 * (n + 1) * own
        axes[axis, SQUARES * LANES + m] = squares + square
    bank.freedom[axis] += 1.0


@inner(fastmath={"contract"})
def _correct(w: Array, lanes: int) -> None:
    """Fills the gains, and updates the covariances."""
    for m in range(lanes):
        h0, h1, h2, h3, h4, h5 = _six(w, _CROSS * LANES + m)
        over = 1.0 / w[_VARIANCE * LANES + m]
        g0, g1, g2, g3, g4, g5 = h0 * over, h1 * over, h2 * over, h3 * over, h4 * over, h5 * over
        w[_GAIN * LANES + m], w[(_GAIN + 1) * LANES + m], w[(_GAIN + 2) * LANES + m] = g0, g1, g2
        w[(_GAIN + 3) * LANES + m], w[(_GAIN + 4) * LANES + m], w[(_GAIN + 5) * LANES + m] = g3, g4, g5
        w[_X00 + m] -= g0 * h0
        w[_X01 + m] -= g0 * h1
        w[_X02 + m] -= g0 * h2
        w[_X11 + m] -= g1 * h1
        w[_X12 + m] -= g1 * h2
        w[_X22 + m] -= g2 * h2
        w[_Y00 + m] -= g3 * h3
        w[_Y01 + m] -= g3 * h4
        w[_Y02 + m] -= g3 * h5
        w[_Y11 + m] -= g4 * h4
        w[_Y12 + m] -= g4 * h5
        w[_Y22 + m] -= g5 * h5
        w[_C00 + m] -= g0 * h3
        w[_C01 + m] -= g0 * h4
        w[_C02 + m] -= g0 * h5
        w[_C10 + m] -= g1 * h3
        w[_C11 + m] -= g1 * h4
        w[_C12 + m] -= g1 * h5
        w[_C20 + m] -= g2 * h3
        w[_C21 + m] -= g2 * h4
        w[_C22 + m] -= g2 * h5


@inner(fastmath={"contract"})
def _learn(w: Array, lanes: int) -> None:
    """Updates trims and start velocities.

    The variance of the innovation becomes that with their uncertainty, and the innovation of the data its square over
    this variance.
    """
    for m in range(lanes):
        e1, e2, e3, e4 = (
            w[(_OFF + 1) * LANES + m], w[(_OFF + 2) * LANES + m], w[(_OFF + 3) * LANES + m], w[(_OFF + 4) * LANES + m],
        )  # fmt: skip
        k1, k2, k3, k4 = (
            w[KNOWN * LANES + m], w[(KNOWN + 1) * LANES + m], w[(KNOWN + 2) * LANES + m], w[(KNOWN + 3) * LANES + m],
        )  # fmt: skip
        p11, p12, p13, p14, p22, p23 = _six(w, SPREAD * LANES + m)
        p24, p33, p34, p44 = (
            w[(SPREAD + 6) * LANES + m], w[(SPREAD + 7) * LANES + m], w[(SPREAD + 8) * LANES + m],
            w[(SPREAD + 9) * LANES + m],
        )  # fmt: skip
        a1, a2 = p11 * e1 + p12 * e2 + p13 * e3 + p14 * e4, p12 * e1 + p22 * e2 + p23 * e3 + p24 * e4
        a3, a4 = p13 * e1 + p23 * e2 + p33 * e3 + p34 * e4, p14 * e1 + p24 * e2 + p34 * e3 + p44 * e4
        variance = w[_VARIANCE * LANES + m] + a1 * e1 + a2 * e2 + a3 * e3 + a4 * e4
        innovation = w[_OFF * LANES + m] - k1 * e1 - k2 * e2 - k3 * e3 - k4 * e4
        over = 1.0 / variance
        b1, b2, b3, b4 = a1 * over, a2 * over, a3 * over, a4 * over
        w[KNOWN * LANES + m], w[(KNOWN + 1) * LANES + m] = k1 + b1 * innovation, k2 + b2 * innovation
        w[(KNOWN + 2) * LANES + m], w[(KNOWN + 3) * LANES + m] = k3 + b3 * innovation, k4 + b4 * innovation
        w[SPREAD * LANES + m], w[(SPREAD + 1) * LANES + m] = p11 - b1 * a1, p12 - b1 * a2
        w[(SPREAD + 2) * LANES + m], w[(SPREAD + 3) * LANES + m] = p13 - b1 * a3, p14 - b1 * a4
        w[(SPREAD + 4) * LANES + m], w[(SPREAD + 5) * LANES + m] = p22 - b2 * a2, p23 - b2 * a3
        w[(SPREAD + 6) * LANES + m], w[(SPREAD + 7) * LANES + m] = p24 - b2 * a4, p33 - b3 * a3
        w[(SPREAD + 8) * LANES + m], w[(SPREAD + 9) * LANES + m] = p34 - b3 * a4, p44 - b4 * a4
        w[_VARIANCE * LANES + m], w[_OFF * LANES + m] = variance, innovation * innovation * over


@inner(fastmath={"contract"})
def logarithm(x: float) -> float:
    """Natural logarithm of a positive normal number, to the last digit; unlike the library's, it vectorises.

    With x = 2^k f and f within a factor sqrt(2) of 1, log f = 2 artanh((f - 1) / (f + 1)).
    """
    bits = np.float64(x).view(np.int64)
    k = (bits - _ROOT_HALF) >> 52
    f = np.int64(bits - (k << 52)).view(np.float64)
    s = (f - 1.0) / (f + 1.0)
    z = s * s
    total = z * (1.0 / 23.0) + 1.0 / 21.0
    total = total * z + 1.0 / 19.0
    total = total * z + 1.0 / 17.0
    total = total * z + 1.0 / 15.0
    total = total * z + 1.0 / 13.0
    total = total * z + 1.0 / 11.0
    total = total * z + 1.0 / 9.0
    total = total * z + 1.0 / 7.0
    total = total * z + 1.0 / 5.0
    total = total * z + 1.0 / 3.0
    return k * _LOG_2 + 2.0 * (s + s * z * total)


@inner()
def probe(bank: Any, t: float) -> None:
    """Stores every member's prediction, to be judged after `AHEAD`; does nothing with a single member."""
    if bank.members == 1 or t < bank.probed[0] + EVERY:
        return
    oldest = 0
    for i in range(PENDING):
        if bank.judged[i, 0] and bank.judged[i, 1]:
            oldest = i
            break
        if bank.due[i] < bank.due[oldest]:
            oldest = i
    bank.probed[0] = t
    bank.due[oldest] = t + AHEAD
    bank.judged[oldest, 0] = bank.judged[oldest, 1] = False
    for m in range(bank.members):
        for j in range(4):
            bank.believed[oldest, j, m] = bank.slots[KNOWN + j, m]
        for i in range(6):
            bank.wind[COLUMNS_FILTERED + oldest, i, m] = disturbance(bank, m, i)


@inner()
def disturbance(bank: Any, m: int, i: int) -> float:
    """Element i of the disturbance of one member, minus the share explained by trims and start velocities."""
    z = bank.wind[0, i, m]
    for j in range(4):
        z -= bank.slots[KNOWN + j, m] * bank.wind[1 + j, i, m]
    return z  # type: ignore[no-any-return]


def weights(bank: Bank) -> Array:
    """Weights of the members for each axis, shape (M, 2)."""
    out: Array = np.empty((bank.members, 2))
    fill_weights(bank, out)
    return out


@kernel()
def fill_weights(bank: Any, out: Array) -> None:
    """Fills the weights, shape (M, 2)."""
    M, slots = bank.members, bank.slots
    for a in range(2):
        least = slots[AXIS * a + ERROR, 0]
        for m in range(M):
            least = min(least, slots[AXIS * a + ERROR, m])
        counted = bank.errors[a] if least > 0 else 0.0
        for m in range(M):
            out[m, a] = TEMPER * slots[AXIS * a + LIKELIHOOD, m]
            if counted > 0:
                out[m, a] -= 0.5 * SHARPNESS * counted * (EVERY / AHEAD) * np.log(slots[AXIS * a + ERROR, m])
        if M > 1:
            out[0, a] += np.log((M - 1) * OWN_SHARE / (1 - OWN_SHARE))
        top, total = out[0, a], 0.0
        for m in range(M):
            top = max(top, out[m, a])
        for m in range(M):
            out[m, a] = np.exp(out[m, a] - top)
            total += out[m, a]
        for m in range(M):
            out[m, a] /= total
