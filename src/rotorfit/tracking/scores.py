"""What the innovations of a flight say of its coefficients, and of the air: rows that the tests for a change take.

Gusts are as strong as in the regime only as long as the air is. Under gusts that have grown the innovations of a filter
that believes in calm air are large and coloured, and what they do to the height within a second is what a payload does.
So every likelihood is kept under stronger gusts, too, and the last seconds say which of them they are of.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.extra_parameters import estimated_extras
from rotorfit.estimation.likelihood.likelihood import response, whiten, whiten_under

WINDOWS = (1.0, 1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0)
"""Lengths of the windows that are looked at [s]."""

LOUDER = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
"""Powers of gusts that the last seconds may have, over those of the regime."""

HEARD = 3.0
"""Time that tells how strong gusts are, at the least [s]."""

PART, PARTS, OWN, OTHERS = 0.5, 6, 3, 4
"""Of so many parts of the last seconds [s] so many are taken, of the axis itself and of x and y: those that are
calmest. A jolt fills two, and is no gust."""

EXPECTED = {"input": 0.3, "damping": 0.5, "delay": 0.05, "lag": 0.5, "trim": 0.5}
"""Sizes of changes that are looked for: as a share of the input, of logarithms, of the delay [s], of the trim [m/s^2,
rad/s^2]. A direction in which a window knows less than this is left out."""

OTHERWISE = 0.5
"""The same of any other parameter of a law, in the estimator's coordinate."""

FADES = 0.7
"""Time constant with which an autopilot learns a new weight or torque [s]."""

BRAKES = 1.0
"""For so long after x and y are let go nothing is asked of z and yaw [s]: many autopilots then brake by the largest
tilt, and what that does to them is no law's."""

LASTS = 4.0
"""Length of the matched filters of jolts [s]."""

TRIMMED = ("z", "yaw")
"""Axes whose trim is the vehicle's: thrust against weight, torque. On x and y it is wind, which is no change."""

Estimates = Sequence[tuple[str, Estimate]]
"""Names and estimates of the axes of one likelihood, which share an optimum."""

Doubts = Mapping[str, Mapping[str, float]]
"""Axis and quantity to the standard deviation by which the law was found wrong, on its own scale."""


@dataclass(frozen=True)
class Scores:
    """Innovations and sensitivities of one likelihood over a regime: N rows in time, P parameters that may change.

    Attributes:
        time: Of each row, shape (N,) [s].
        innovation: Whitened, shape (N,).
        tested: By the parameters that may change, on the scale of `EXPECTED`, shape (N, P).
        free: By trims and start velocities that may be another in every window, shape (N, Q).
        names: `AXIS.QUANTITY` of each that may change.
        scale: What one unit of it is.
        doubt: Standard deviation by which tests of the law found each to vary without a change, on that scale, (P,).
        jolts: Whitened positions of an axis of `TRIMMED` after an acceleration, and of poses that are wrong, see
            `_jolts`, shape (N, 3); none of other axes.
        density: Logarithm of the density of each row under gusts as strong as in the regime, and under each of
            `LOUDER`, shape (N, 1 + L).
        louder: The same scores under stronger gusts, up to the strongest that the last seconds may have had.
        gusts: How many of these what all axes do now calls for, jolts left out; see `_gusts_now`.
    """

    time: Array
    innovation: Array
    tested: Array
    free: Array
    names: tuple[str, ...]
    scale: Array
    doubt: Array
    jolts: Array
    density: Array
    louder: "tuple[Scores, ...]" = ()
    gusts: int = 0

    @cached_property
    def rows(self) -> Array:
        """Innovations, what is tested and what is free side by side, shape (N, 1 + P + Q)."""
        return np.column_stack([self.innovation, self.tested, self.free])

    @cached_property
    def products(self) -> Array:
        """Of all rows with each other, summed, shape (1 + P + Q, 1 + P + Q)."""
        return np.asarray(self.rows.T @ self.rows)

    def heard(self, since: float) -> Array:
        """Log-likelihood of each strength of gusts since some time, or for the last `HEARD`, shape (1 + L,)."""
        late = int(np.searchsorted(self.time, min(since, self.time[-1] - HEARD)))
        return np.asarray(self.density[late:].sum(axis=0))


def scores_of(parts: Sequence[tuple[Estimates, Doubts]], let_go: Array | None = None) -> list[Scores]:
    """The scores of likelihoods of one flight.

    Args:
        parts: Estimates of each, and what their laws were found wrong by.
        let_go: When the commands of x and y were let go, shape (n,) [s]; None where that is of no account.
    """
    return _in_one_air([_Whitened(*part, np.empty(0) if let_go is None else let_go) for part in parts])


def let_go(flight: Flight) -> Array:
    """When the commands of x and y both became zero, shape (n,) [s]."""
    moving = np.any(flight.command[:, [AXES.index("x"), AXES.index("y")]] != 0, axis=1)
    return np.asarray(flight.command_time[1:][moving[:-1] & ~moving[1:]])


class _Whitened:
    """One likelihood, before it is known how strong gusts are.

    Args:
        estimates: Of its axes.
        doubts: By which their laws were found wrong.
        let_go: When x and y were let go [s].
    """

    def __init__(self, estimates: Estimates, doubts: Doubts, let_go: Array) -> None:
        first = estimates[0][1]
        (self._rec,), point = first.records, first.optimum.point
        self._estimates, self._doubts = estimates, doubts
        mean, sensitivity = response(self._rec, point, 0, point.start)
        parts = [(self._rec.position - mean)[:, None], sensitivity, _jolts(self._rec, estimates)]
        self._columns = np.concatenate(parts, axis=1)
        self._levels = np.repeat(point.levels[None], 1 + len(LOUDER), axis=0)
        self._levels[1:, :, 0] += np.log(LOUDER)[:, None]
        rows, innovations, variance = whiten_under(self._rec, self._columns, self._levels)
        self._told = np.ones(self._rec.count.size)
        if estimates[0][0] in TRIMMED and let_go.size:
            last = np.searchsorted(let_go, self._rec.block_time, side="right") - 1
            self._told[(last >= 0) & (self._rec.block_time < let_go[last] + BRAKES)] = 0.0
        density = -0.5 * (innovations**2 + np.log(variance)) * self._told[:, None]
        self._density = density.reshape(len(self._levels), -1).T
        self.scores = self._scored(rows)

    def under(self, gusts: int) -> Scores:
        """With what all axes say of the air."""
        now = float(self.scores.time[-1])
        loudest = max(gusts, *(int(np.argmax(self.scores.heard(now - window))) for window in WINDOWS))
        rows = (whiten(self._rec, self._columns, levels)[0] for levels in self._levels[1 : loudest + 1])
        return replace(self.scores, louder=tuple(map(self._scored, rows)), gusts=gusts)

    def _scored(self, rows: Array) -> Scores:
        """From whitened columns, shape (B, C, K)."""
        point, K = self._estimates[0][1].optimum.point, rows.shape[2]
        told = np.ones(rows.shape[:2])
        told[self._told == 0, : 1 + point.coefficients + 2 * K] = 0.0  # jolts are shapes, which have no time
        rows = (rows * told[:, :, None]).transpose(0, 2, 1).reshape(-1, rows.shape[1])
        innovation, columns = rows[:, 0], rows[:, 1:]
        trim, start = point.coefficients, point.coefficients + K
        tested, names, scale, doubt, own = [], [], [], [], []
        for axis, estimate in self._estimates:
            k = estimate.place
            for name in ("input", "damping", "delay", *(extra.name for extra in estimated_extras(estimate.optimum, k))):
                size = EXPECTED.get(name, OTHERWISE)
                unit = size * (float(point.gain[k]) if name == "input" else 1.0)
                tested.append(columns[:, point.place(name, k)] * unit)
                names.append(f"{axis}.{name}")
                scale.append(size)
                doubt.append(self._doubts.get(axis, {}).get(name, 0.0) / size)
            if axis in TRIMMED:
                tested.append(columns[:, trim + k] * EXPECTED["trim"])
                names.append(f"{axis}.trim")
                scale.append(EXPECTED["trim"])
                doubt.append(0.0)
                own.append(k)
        segment = np.repeat(np.cumsum(self._rec.fresh) - 1, K)
        free = [columns[:, trim + k] for k in range(K) if k not in own]
        free += [columns[:, start + k] * (segment == s) for k in range(K) for s in range(self._rec.starts.size)]
        time = np.repeat(self._rec.block_time, K)
        return Scores(
            time, innovation, np.column_stack(tested), np.column_stack(free), tuple(names), np.array(scale),
            np.array(doubt), columns[:, start + K :], self._density,
        )  # fmt: skip


def _in_one_air(seen: Sequence[_Whitened]) -> list[Scores]:
    """Scores of all likelihoods, under gusts as strong as x and y say, those of `TRIMMED` as that axis says, too."""
    horizontal = [_calmest(one.scores, OTHERS) for one in seen if not one.scores.jolts.size]
    out = []
    for one in seen:
        told = [_calmest(one.scores, OWN)] if one.scores.jolts.size else []
        told += [np.sum(horizontal, axis=0)] if horizontal else []
        gusts = max(int(np.argmax(each)) for each in told)
        out.append(one.under(min(gusts + 1, len(LOUDER)) if gusts else 0))  # the calmest parts tell too little
    return out


def _calmest(scores: Scores, parts: int) -> Array:
    """Log-likelihood of each strength of gusts in the calmest of the last `PARTS`, shape (1 + L,)."""
    ends = np.searchsorted(scores.time, scores.time[-1] + 1e-9 - PART * np.arange(PARTS, -1, -1))
    each = np.add.reduceat(scores.density[: ends[-1]], np.minimum(ends[:-1], ends[-1] - 1), axis=0)
    each = np.where(np.diff(ends)[:, None] > 0, each, 0.0)  # no pose
    louder = each[:, len(LOUDER) // 2] - each[:, 0]
    return np.asarray(each[np.argsort(louder)[:parts]].sum(axis=0))


def _jolts(rec: Record, estimates: Sequence[tuple[str, Estimate]]) -> Array:
    """Positions after an acceleration that fades as an autopilot learns it, at one pose alone, after a step: (B, 3, K).

    All begin `LASTS` before the end; v' = -b v + a exp(-t / `FADES`). The last two are what a pose that is wrong does.
    """
    axis, estimate = estimates[0]
    t = rec.block_time - (rec.block_time[-1] - LASTS)
    if axis not in TRIMMED or t[0] > -LASTS:
        return np.empty((rec.count.size, 0, len(rec.axes)))
    b, fade = float(np.exp(estimate.optimum.point.log_damping[estimate.place])), 1.001 / FADES
    later = np.maximum(t, 0.0)
    rise = (-np.expm1(-fade * later) / fade + np.expm1(-b * later) / b) / (b - fade)
    first = int(np.searchsorted(t, 0.0))
    columns = np.column_stack([EXPECTED["trim"] * rise, np.arange(t.size) == first, np.arange(t.size) >= first])
    return np.asarray(columns[:, :, None])
