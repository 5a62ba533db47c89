"""Innovations of a flight and their sensitivities, under several strengths of gusts: input of the tests for a change.

If gusts grow, the innovations of a filter that assumes calm air become large and coloured, and within a second they
move the height as a payload would. Every likelihood is therefore also evaluated under stronger gusts, and the last
seconds select the strength that explains them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, Indices, Mask
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.extra_parameters import estimated_extras
from rotorfit.estimation.likelihood.likelihood import whiten, whiten_under

WINDOWS = (1.0, 1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0)
"""Lengths of the windows that are tested [s]."""

GUST_POWERS = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
"""Powers of gusts that the last seconds may have, over those of the regime."""

LEAST_GUST_TIME = 3.0
"""Shortest time from which the strength of gusts is determined, but in a window of x and y [s]."""

PART, PARTS, OWN, OTHERS = 0.5, 6, 3, 4
"""Length [s] and number of the last parts of the flight from which gusts are judged; how many of them count, the
calmest, of the axis itself and of x and y. A jolt fills two parts and is not a gust."""

CHUNK = 1.0
"""Length of the stretches whose sums of scores count as independent [s]."""

EXPECTED = {"input": 0.3, "damping": 0.5, "delay": 0.05, "lag": 0.5, "trim": 0.5}
"""Sizes of the changes that are tested for, and units of the scores: relative for the input, logarithmic for damping
and lag, [s] for the delay, [m/s^2, rad/s^2] for the trim. Directions that a window determines less well are left
out."""

EXPECTED_OTHER = 0.5
"""As `EXPECTED`, for any other parameter of a law, in the estimator's coordinate."""

LEAST_DOUBT = {"input": 0.015, "delay": 0.002, "trim": 0.015}
"""Standard deviation by which an answer differs from the law without a change, whatever the tests of the law found, in
the units of `EXPECTED`: in still air the poses tell changes that no pilot and no controller would notice, and the
braking of x and y, a tilt or a stale command moves z by as much."""

FADES = 0.7
"""Time constant with which an autopilot learns a new weight or torque [s]."""

BRAKES = 1.0
"""Time after the commands of x and y become zero in which z and yaw are not tested, nor x and y where their fit leaves
the rest out and an answer begins so soon [s]: many autopilots then brake with the largest tilt, which no law describes.
"""

STEEP, AT_ONCE, TILTING = 1.5, 0.1, 0.5
"""Change of the acceleration that x and y command together [m/s^2], 9 degrees of tilt, within a time [s], after which z
and yaw are not tested, and how long they are not [s]: rotors that turn the vehicle over lift and twist it for a moment.
"""

LASTS = 4.0
"""Length of the matched filters of jolts [s]."""

TRIMMED = ("z", "yaw")
"""Axes whose trim belongs to the vehicle: thrust minus weight, torque. On x and y it is wind, which is no change."""

Estimates = Sequence[tuple[str, Estimate]]
"""Names and estimates of the axes of one likelihood, which share an optimum."""

Doubts = Mapping[str, Mapping[str, float]]
"""Axis and quantity to the standard deviation by which it was found to vary under the law, on its own scale."""


@dataclass(frozen=True)
class Sticks:
    """When the commands of x and y changed so abruptly that other axes feel it.

    Attributes:
        let_go: Times at which both became zero, shape (n,) [s].
        steep: Times at which they changed by `STEEP` within `AT_ONCE`, shape (m,) [s].
    """

    let_go: Array = field(default_factory=lambda: np.empty(0))
    steep: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True)
class Scores:
    """Innovations and sensitivities of one likelihood over a regime: N rows in time, P parameters that may change.

    Attributes:
        time: Time of each row, shape (N,) [s].
        innovation: Whitened innovations, shape (N,).
        tested: Their sensitivities to the parameters that may change, in units of `EXPECTED`, shape (N, P).
        free: Their sensitivities to the trims and start velocities that each window may choose, shape (N, Q).
        names: `AXIS.QUANTITY` of each parameter that may change.
        scale: Its unit, from `EXPECTED`, shape (P,).
        doubt: Standard deviation by which tests of the law found it to vary without a change, in that unit, shape (P,).
        jolts: Whitened position of an axis of `TRIMMED` after a jolt, and after two kinds of wrong poses, see `_jolts`,
            shape (N, 3); shape (N, 0) for other axes.
        pushed: Gives the whitened positions of an axis of `TRIMMED` after pushes at an instant [s] that fade with some
            time constants, shape (T,) [s]: in the unit of the jolts, shape (T, N).
        begun: Gives the sensitivities `tested` to shifts that begin at an instant [s], shape (N, P): the motion goes on
            from the place and velocity that it has then, zero before. That of a delay is its mean over the shift [s].
        tested_rows: Which rows are tested, shape (N,): not those in which x and y were commanded too hard.
        density: Log-density of each row under gusts as strong as in the regime, and under each of `GUST_POWERS`, up to
            a constant, shape (N, 1 + L).
        under_gusts: The scores under stronger gusts, up to the strongest that the last seconds may have had.
        gusts: Strength of the gusts now, judged from all axes without their jolts: 0 for that of the regime, k for
            `GUST_POWERS[k - 1]`; see `_in_one_air`.
        air: Log-likelihood of each strength in the seconds it is judged from, of all axes together, shape (1 + L,).
    """

    time: Array
    innovation: Array
    tested: Array
    free: Array
    names: tuple[str, ...]
    scale: Array
    doubt: Array
    jolts: Array
    pushed: Callable[[float, Array], Array]
    begun: Callable[[float, float], Array]
    tested_rows: Mask
    density: Array
    under_gusts: "tuple[Scores, ...]" = ()
    gusts: int = 0
    air: Array = field(default_factory=lambda: np.zeros(1 + len(GUST_POWERS)))

    @property
    def trimmed(self) -> bool:
        """Whether it is the likelihood of axes of `TRIMMED`."""
        return any(name.endswith(".trim") for name in self.names)

    @cached_property
    def rows(self) -> Array:
        """`innovation`, `tested` and `free` side by side, shape (N, 1 + P + Q)."""
        return np.column_stack([self.innovation, self.tested, self.free])

    @cached_property
    def products(self) -> Array:
        """Inner products of the columns of `rows`, shape (1 + P + Q, 1 + P + Q)."""
        return np.asarray(self.rows.T @ self.rows)

    @cached_property
    def _chunks(self) -> Indices:
        """First row of each chunk of time."""
        return np.flatnonzero(np.diff(np.floor(self.time / CHUNK), prepend=-1.0))

    @cached_property
    def _each(self) -> Array:
        """Contribution of each row to the scores of the tested parameters, shape (N, P)."""
        return self.tested * self.innovation[:, None]

    @cached_property
    def _of_chunks(self) -> tuple[Array, Array]:
        """Sums of the scores over each chunk, shape (C, P), and the products of `_each`, shape (P, P)."""
        return np.add.reduceat(self._each, self._chunks, axis=0), self._each.T @ self._each

    def untested(self, since: float) -> tuple[int, int]:
        """Number of rows after a time [s] that are not tested, and of all rows after it."""
        later = self.tested_rows[self.time > since]
        return int(np.count_nonzero(~later)), later.size

    def chunks_before(self, at: int) -> int:
        """Number of chunks that begin before a row."""
        return int(np.searchsorted(self._chunks, at))

    def seconds(self, count: int) -> Array:
        """The whole seconds that the first `count` chunks lie in, shape (count,)."""
        return np.floor(self.time[self._chunks[:count]] / CHUNK)

    def before(self, at: int) -> tuple[Array, Array]:
        """Sums of the scores over each chunk before a row, shape (C, P), and the products of the scores there."""
        (sums, products), last = self._of_chunks, self.chunks_before(at) - 1
        late = self._each[at:]
        ended = np.vstack([sums[:last], self._each[self._chunks[last] : at].sum(axis=0)])
        return ended, products - late.T @ late

    @cached_property
    def _later(self) -> Array:
        """Sums of `density` from each row on, shape (N, 1 + L)."""
        return np.asarray(np.cumsum(self.density[::-1], axis=0)[::-1])

    def gust_likelihood(self, since: float) -> Array:
        """Log-likelihood of each strength of gusts from `since` [s] on, shape (1 + L,).

        Of an axis of `TRIMMED`, which the vehicle may push, over at least `LEAST_GUST_TIME`.
        """
        since = min(since, float(self.time[-1]) - LEAST_GUST_TIME) if self.trimmed else since
        return self._later[int(np.searchsorted(self.time, since))]  # type: ignore[no-any-return]


def scores_of(
    parts: Sequence[tuple[Estimates, Doubts]], sticks: Sticks | None = None, gusts: int | None = None
) -> list[Scores]:
    """The scores of the likelihoods of one flight.

    Args:
        parts: Estimates of each likelihood, and the doubts about their laws.
        sticks: Abrupt commands of x and y; None to ignore them.
        gusts: The strength of the gusts now, see `Scores.gusts`; None to judge it.
    """
    return _in_one_air([_Whitened(*part, sticks or Sticks()) for part in parts], gusts)


def sticks_of(flight: Flight, parts: Sequence[tuple[Estimates, Doubts]]) -> Sticks:
    """The abrupt commands of x and y in a flight.

    Args:
        flight: The flight.
        parts: As for `scores_of`; an axis without an estimate counts as one that commands no acceleration.
    """
    time, command = flight.command_time, flight.command[:, [AXES.index("x"), AXES.index("y")]]
    moving = np.any(command != 0, axis=1)
    inputs = {axis: one.optimum.point.gain[one.place] for estimates, _ in parts for axis, one in estimates}
    acceleration = command * [inputs.get("x", 0.0), inputs.get("y", 0.0)]
    before = np.maximum(np.searchsorted(time, time - AT_ONCE, side="right") - 1, 0)
    steep = np.linalg.norm(acceleration - acceleration[before], axis=1) > STEEP
    return Sticks(time[1:][moving[:-1] & ~moving[1:]], time[steep])


class _Whitened:
    """One likelihood, before the strength of gusts is known.

    Args:
        estimates: Estimates of its axes.
        doubts: Doubts about their laws.
        sticks: Abrupt commands of x and y.
    """

    def __init__(self, estimates: Estimates, doubts: Doubts, sticks: Sticks) -> None:
        first = estimates[0][1]
        (self._rec,), point = first.records, first.optimum.point
        self._estimates, self._doubts = estimates, doubts
        mean, sensitivity = response(self._rec, point, 0, point.start)
        self._sensitivity = sensitivity
        parts = [(self._rec.position - mean)[:, None], sensitivity, _jolts(self._rec, estimates)]
        self._columns = np.concatenate(parts, axis=1)
        self._levels = np.repeat(point.levels[None], 1 + len(GUST_POWERS), axis=0)
        self._levels[1:, :, 0] += np.log(GUST_POWERS)[:, None]
        rows, innovations, variance = whiten_under(self._rec, self._columns, self._levels)
        silent = _jerked if estimates[0][0] in TRIMMED else _begun_braking
        self._valid = np.where(silent(self._rec, sticks), 0.0, 1.0)
        density = -0.5 * (innovations**2 + np.log(variance)) * self._valid[:, None]
        self._density = density.reshape(len(self._levels), -1).T
        self.scores = self._scored(rows, self._levels[0])

    def under(self, gusts: int, air: Array) -> Scores:
        """The scores, given the strength of gusts that all axes show, and its evidence (see `Scores`)."""
        now = float(self.scores.time[-1])
        strongest = max(gusts, *(int(np.argmax(self.scores.gust_likelihood(now - window))) for window in WINDOWS))
        stronger = self._levels[1 : strongest + 1]
        under = tuple(self._scored(whiten(self._rec, self._columns, levels)[0], levels) for levels in stronger)
        return replace(self.scores, under_gusts=under, gusts=gusts, air=air)

    def _scored(self, rows: Array, levels: Array) -> Scores:
        """Scores from whitened columns, shape (B, C, K), under some levels."""
        point, K = self._estimates[0][1].optimum.point, rows.shape[2]
        if not self._valid.all():
            valid = np.ones(rows.shape[:2])
            valid[self._valid == 0, : 1 + point.coefficients + 2 * K] = 0.0  # the shapes of jolts belong to no time
            rows = rows * valid[:, :, None]
        rows = rows.transpose(0, 2, 1).reshape(-1, rows.shape[1])
        innovation, columns = rows[:, 0], rows[:, 1:]
        trim, start = point.coefficients, point.coefficients + K
        names, scale, doubt, own, place, units = [], [], [], [], [], []
        for axis, estimate in self._estimates:
            k = estimate.place
            for name in ("input", "damping", "delay", *(extra.name for extra in estimated_extras(estimate.optimum, k))):
                size = EXPECTED.get(name, EXPECTED_OTHER)
                units.append(size * (float(point.gain[k]) if name == "input" else 1.0))
                place.append(point.place(name, k))
                names.append(f"{axis}.{name}")
                scale.append(size)
                doubt.append(max(self._doubts.get(axis, {}).get(name, 0.0), LEAST_DOUBT.get(name, 0.0)) / size)
            if axis in TRIMMED:
                place.append(trim + k)
                units.append(EXPECTED["trim"])
                names.append(f"{axis}.trim")
                scale.append(EXPECTED["trim"])
                doubt.append(LEAST_DOUBT["trim"] / EXPECTED["trim"])
                own.append(k)
        at, unit, delays = np.array(place), np.array(units), np.array([name.endswith(".delay") for name in names])
        damping = float(np.exp(point.log_damping.mean()))
        segment = np.repeat(self._rec.segment, K)
        free = [columns[:, trim + k] for k in range(K) if k not in own]
        free += [columns[:, start + k] * (segment == s) for k in range(K) for s in range(self._rec.starts.size)]
        time = np.repeat(self._rec.block_time, K)
        return Scores(
            time, innovation, columns[:, at] * unit, np.column_stack(free), tuple(names), np.array(scale),
            np.array(doubt), columns[:, start + K :],
            partial(_pushed, self._rec, self._estimates[0][1], levels, self._valid),
            partial(_begun, self._rec, self._sensitivity, at, unit, delays, damping, levels, self._valid),
            np.repeat(self._valid == 1, K), self._density,
        )  # fmt: skip


def _jerked(rec: Record, sticks: Sticks) -> Mask:
    """The blocks in which a braking or tilting vehicle may lift and twist itself, shape (B,)."""
    time = rec.block_time
    return np.asarray((time < _latest(sticks.let_go, time) + BRAKES) | (time < _latest(sticks.steep, time) + TILTING))


def _begun_braking(rec: Record, sticks: Sticks) -> Mask:
    """The blocks of a braking vehicle in answers that began while it braked, shape (B,)."""
    begun = rec.block_time[np.flatnonzero(rec.fresh)][rec.segment]
    let_go = _latest(sticks.let_go, rec.block_time)
    return np.asarray((rec.block_time < let_go + BRAKES) & (begun > let_go))


def _latest(events: Array, time: Array) -> Array:
    """The last of some events until each time [s], both ascending; -inf before the first."""
    return np.asarray(np.append(-np.inf, events)[np.searchsorted(events, time, side="right")])


def _in_one_air(seen: Sequence[_Whitened], gusts: int | None) -> list[Scores]:
    """Scores of all likelihoods under the gusts that x and y show; an axis of `TRIMMED` may show stronger ones."""
    horizontal = [_calmest(one.scores, OTHERS) for one in seen if not one.scores.jolts.size]
    out = []
    for one in seen:
        told = [_calmest(one.scores, OWN)] if one.scores.jolts.size else []
        told += [np.sum(horizontal, axis=0)] if horizontal else []
        judged = max(int(np.argmax(each)) for each in told)
        judged = min(judged + 1, len(GUST_POWERS)) if judged else 0  # the calmest parts show too little
        out.append(one.under(judged if gusts is None else gusts, np.sum(told, axis=0)))
    return out


def _calmest(scores: Scores, parts: int) -> Array:
    """Log-likelihood of each strength of gusts in the calmest `parts` of the last `PARTS`, shape (1 + L,)."""
    ends = np.searchsorted(scores.time, scores.time[-1] + 1e-9 - PART * np.arange(PARTS, -1, -1))
    each = np.add.reduceat(scores.density[: ends[-1]], np.minimum(ends[:-1], ends[-1] - 1), axis=0)
    each = np.where(np.diff(ends)[:, None] > 0, each, 0.0)  # no pose
    restless = each[:, len(GUST_POWERS) // 2] - each[:, 0]
    return np.asarray(each[np.argsort(restless)[:parts]].sum(axis=0))


def _jolts(rec: Record, estimates: Sequence[tuple[str, Estimate]]) -> Array:
    """Positions after an acceleration that fades as an autopilot learns it, at one wrong pose, after a step: (B, 3, K).

    All begin `LASTS` before the end; v' = -b v + a exp(-t / `FADES`). The last two are the signatures of wrong poses.
    """
    axis, estimate = estimates[0]
    t = rec.block_time - (rec.block_time[-1] - LASTS)
    if axis not in TRIMMED or t[0] > -LASTS:
        return np.empty((rec.count.size, 0, len(rec.axes)))
    first = int(np.searchsorted(t, 0.0))
    rise = EXPECTED["trim"] * _after_a_push(estimate, t, np.array(FADES))
    columns = np.column_stack([rise, np.arange(t.size) == first, np.arange(t.size) >= first])
    return np.asarray(columns[:, :, None])


def _pushed(rec: Record, estimate: Estimate, levels: Array, valid: Array, instant: float, fades: Array) -> Array:
    """See `Scores.pushed`. A function and no method: scores that held their likelihood would be freed late."""
    after = EXPECTED["trim"] * _after_a_push(estimate, rec.block_time[:, None] - instant, fades)
    return np.asarray(whiten(rec, after[:, :, None], levels)[0][:, :, 0].T * valid)


def _begun(
    rec: Record, sensitivity: Array, place: Indices, unit: Array, delays: Mask, damping: float, levels: Array,
    valid: Array, instant: float, later: float,
) -> Array:  # fmt: skip
    """See `Scores.begun`.

    An answer that comes later by d is the same answer, moved: the difference is d times the mean sensitivity to the
    delay over the last d. What the sensitivity would do from its place and velocity at the instant is taken off it.

    Args:
        rec: The flight.
        sensitivity: Of the positions, shape (B, C, K).
        place: Columns of the parameters that may change, shape (P,).
        unit: Their units, shape (P,).
        delays: Which of them are delays, shape (P,).
        damping: Of the velocity that is left [1/s].
        levels, valid: As for `_pushed`.
        instant: When the shifts begin [s].
        later: By how much the delays shift [s].
    """
    moved, t = sensitivity[:, place] * unit[:, None], rec.block_time - instant
    if abs(later) > 1e-3:
        moved[:, delays] = _mean_over_the_last(later, t, moved[:, delays])
    at = int(np.clip(np.searchsorted(t, 0.0), 1, t.size - 1))
    velocity, gone = (moved[at] - moved[at - 1]) / (t[at] - t[at - 1]), np.maximum(t, 0.0)[:, None, None]
    moved = moved - moved[at - 1] + velocity * (t[at - 1] + np.expm1(-damping * gone) / damping)
    rows = whiten(rec, np.where(gone > 0, moved, 0.0), levels)[0] * valid[:, None, None]
    return np.asarray(rows.transpose(0, 2, 1).reshape(-1, place.size))


def _mean_over_the_last(duration: float, time: Array, values: Array) -> Array:
    """Means of series, shape (B, P, K), over a time before each row, or after it if that is negative [s]."""
    steps = np.diff(time, prepend=2 * time[0] - time[1])
    total = np.cumsum(values * steps[:, None, None], axis=0)
    out = np.empty_like(values)
    for p, k in np.ndindex(values.shape[1:]):
        out[:, p, k] = (total[:, p, k] - np.interp(time - duration, time, total[:, p, k])) / duration
    return out


def _after_a_push(estimate: Estimate, t: Array, fades: Array) -> Array:
    """Position at times t after an acceleration of 1 that fades as exp(-t / `fades`), v' = -b v + a; zero before."""
    b, rate = float(np.exp(estimate.optimum.point.log_damping[estimate.place])), 1.001 / fades
    later = np.maximum(t, 0.0)
    return np.asarray((-np.expm1(-rate * later) / rate + np.expm1(-b * later) / b) / (b - rate))
