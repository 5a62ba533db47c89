"""Retuning: when the gains that are flown are to be others, from one model after the other of a vehicle in flight.

An axis is looked at where a fit says something new of it and it has settled: two fits in a row, the second of half as
much data again, or what is believed after them, agree within the interval of the first, and that does not shrink
faster than noise lets it. New gains are published

- where none are flown;
- where the vehicle has changed, its new self has settled, and those that are flown do not hold for all of it: for more
  than 5 % of what its interval allows they leave less than `LOST` and `LOST_DELAY`;
- where it has not changed, but they probably do not hold: the same for more than half of it;
- where they are for another vehicle: its coefficients lie outside of what both intervals explain, and new ones would
  be as fast: slower ones only because they must;
- where the vehicle is known so much better that they would be `FASTER` times as fast.

Otherwise they stay. What lies between `PEAK` and `LOST`, and between 1 and `FASTER`, is the hysteresis. Without
excitation there is no new fit, and nothing is published.

What is known from before is carried over: of an earlier model, as long as this flight tells less and does not
contradict it, and over an alarm those coefficients k that its cause leaves as they were. With what was known before,
N(m, C)_k, and the new fit N(m', C'), the others f follow the new fit where the carried ones are what they were:

    m_f = m'_f + K (m_k - m'_k),    C_ff = C'_ff - K C'_kf + K C_kk K',    C_fk = K C_kk,    K = C'_fk (C'_kk)^-1

What the new fit says of k is left unused, because both hold the same flight-to-flight spread; where it tells more, or
lies outside of 99 % of what both allow, it stands alone.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtr

from rotorfit.control.control_law import AxisLaw, Kind
from rotorfit.control.robustness import believed_possible, doubt, share_beyond
from rotorfit.control.tuning import DELAY_SHARE, DRAWS, LATENCY, RATE, AxisTuning, Tuning, tune
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS, Axis, Model, Plain, Predictor, Weighed, first_order, weighed

LOST = 2.0
"""Peak of the sensitivity from which a margin is lost. Source: as of `tuning.PEAK`: the upper end of what loops are
tuned to."""

CARRIED: Mapping[str, tuple[str, ...]] = {
    "limits": ("damping", "delay"),
    "delay": ("input", "damping"),
    "payload": COEFFICIENTS,
    "thrust": COEFFICIENTS,
}
"""Cause of an alarm to what it leaves as it was; of one that is not named nothing. A payload and lost thrust change the
trim, which no gains hold; the damping of x and y falls with the mass, by less than a flight in wind tells."""

CONTRADICTED = 0.99
"""Probability that what is carried over and the new fit lie as far apart as here, from which the fit stands alone."""

LOST_DELAY = 0.6 * DELAY_SHARE
"""The same of the delay margin, as a share of the reach of the loop."""

ANEW, PROBABLY = 0.05, 0.5
"""Share of what the vehicle may be without margins at which gains are given up: after a change, and without one."""

FASTER = 1.15
"""Ratio of bandwidths from which it is worth while to change gains that hold."""

SETTLED = 0.7
"""Ratio of standard errors of one fit to those of the fit before, from which they have settled: with half as much data
again noise alone leaves 0.82."""

EXPLAINED = 16.27
"""99.9 % of the squared distance of three coefficients, chi-squared, that lie as far apart as both intervals say."""

AGREES = 1.96
"""Standard errors of the fit before within which the next agrees with it."""


@dataclass(frozen=True)
class Flown:
    """Gains of one axis that are flown: the law, and its bandwidth [rad/s]."""

    law: AxisLaw
    bandwidth: float


@dataclass(frozen=True)
class Retuned:
    """New gains: of some axes, and for each why."""

    tuning: Tuning
    why: Mapping[str, str]


class Retuning:
    """Follows the models of one vehicle.

    Args:
        kind: Design of the gains.
        rate: Commands a second.
        latency: From the exposure of a pose to the command that uses it [s].
        flown: Axis name to the gains that are flown; empty where that is not known.
        before: What the vehicle was on an earlier flight; None where nothing is known.
    """

    def __init__(
        self,
        kind: Kind = "predictor",
        rate: float = RATE,
        latency: float = LATENCY,
        flown: Mapping[str, Flown] | None = None,
        before: Model | None = None,
    ) -> None:
        self._kind, self._rate, self._latency = kind, rate, latency
        self._flown = dict(flown or {})
        self._fits: dict[str, tuple[Axis, Weighed, Weighed]] = {}
        known = before.axes if before else {}
        self._before = {axis: first_order(before, axis) for axis, one in known.items() if before and one.predictor}
        self._carried: dict[str, tuple[str, ...]] = dict.fromkeys(AXES, COEFFICIENTS)
        self._anew: set[str] = set()

    def changed(self, axes: Collection[str], cause: str) -> None:
        """Some axes are of another vehicle from now on.

        Args:
            axes: Their names.
            cause: Of the alarm; what it leaves as it was is still known.
        """
        for axis in axes:
            last = self._fits.pop(axis, None)
            if last:
                self._before[axis] = last[2]
            self._carried[axis] = tuple(name for name in self._carried[axis] if name in CARRIED.get(cause, ()))
            if self._carried[axis] != COEFFICIENTS:
                self._anew.add(axis)

    def look(self, model: Model, known: Collection[str], excited: Collection[str] = ()) -> Retuned | None:
        """New gains, where the model calls for them.

        Args:
            model: As of the last fit of each axis.
            known: Axes that it is known of.
            excited: Axes of which it tells something: enough where the rest is carried over.
        """
        new: dict[str, AxisTuning] = {}
        why: dict[str, str] = {}
        for axis in (axis for axis in AXES if axis in known or axis in excited):
            belief = self._settled(model, axis, axis in known)
            if belief is None:
                continue
            believed = _with_law(model, axis, belief)
            if fresh := self._tuned(believed, axis):
                reason = self._reason(believed, axis, fresh)
                if reason:
                    new[axis], why[axis] = fresh, reason
                    self._flown[axis] = Flown(fresh.law, fresh.bandwidth)
        return Retuned(Tuning(self._kind, self._rate, self._latency, new, {}), why) if new else None

    def _settled(self, model: Model, axis: str, known: bool) -> Weighed | None:
        """What is believed of an axis, where there is a new fit and it says the same as before, and not much more."""
        before = self._fits.get(axis)
        if model.axes[axis].predictor is None or (before and before[0] is model.axes[axis]):
            return None
        fit = first_order(model, axis)
        now = self._belief(axis, fit)
        if not known and now is fit:
            return None
        self._fits[axis] = model.axes[axis], fit, now
        if before is None:
            return None
        return now if (known and _same(before[1], fit)) or _same(before[2], now) else None

    def _belief(self, axis: str, now: Weighed) -> Weighed:
        """What is believed of an axis: the last fit, and what is carried over."""
        before = self._before.get(axis)
        return now if before is None else _carried_over(before, now, self._carried[axis])

    def _tuned(self, model: Model, axis: str) -> AxisTuning | None:
        """Gains for an axis; None where no margins hold."""
        try:
            return tune(model, self._kind, rate=self._rate, latency=self._latency, axes=(axis,)).axes[axis]
        except ModelError:
            return None

    def _reason(self, model: Model, axis: str, fresh: AxisTuning) -> str:
        """Why gains are to be these; empty where those that are flown may stay."""
        flown = self._flown.get(axis)
        if flown is None:
            return "the first: the vehicle's interval has settled"
        vehicles = doubt(believed_possible(model, axis, DRAWS, 0), 1 / self._rate, self._latency, 0)
        lost = share_beyond(flown.law, vehicles, LOST, LOST_DELAY * flown.law.reach)
        anew = axis in self._anew
        self._anew.discard(axis)
        if lost > (ANEW if anew else PROBABLY):
            since = "the vehicle has changed: " if anew else ""
            return f"{since}those flown keep no margins for {100 * lost:.0f} % of what it may be"
        if _apart(flown.law, model, axis) > EXPLAINED and FASTER * fresh.bandwidth >= flown.bandwidth:
            return "those flown are for another vehicle than its interval allows"
        if fresh.bandwidth >= FASTER * flown.bandwidth:
            return f"the vehicle is known better: {fresh.bandwidth / flown.bandwidth:.1f} times as fast"
        return ""


def _same(old: Weighed, now: Weighed) -> bool:
    """Whether a law says the same as the one before, and not much more."""
    if any(name not in law.stderr for law in (old, now) for name in COEFFICIENTS):
        return False
    return all(
        abs(getattr(now.predictor, name) - getattr(old.predictor, name)) <= AGREES * old.stderr[name]
        and now.stderr[name] >= SETTLED * old.stderr[name]
        for name in COEFFICIENTS
    )


def _carried_over(before: Weighed, now: Weighed, names: Collection[str]) -> Weighed:
    """A fit, with some coefficients as they were known before; the fit where that says less, or something else."""
    if not names or any(name not in law.stderr for law in (before, now) for name in COEFFICIENTS):
        return now
    (old, old_covariance), (new, new_covariance) = _normal(before), _normal(now)
    kept = np.array([name in names for name in COEFFICIENTS])
    was, known = old_covariance[np.ix_(kept, kept)], new_covariance[np.ix_(kept, kept)]
    off = old[kept] - new[kept]
    apart = float(off @ np.linalg.solve(was + known, off))
    if np.linalg.det(known) <= np.linalg.det(was) or chdtr(kept.sum(), apart) > CONTRADICTED:
        return now
    follow = new_covariance[np.ix_(~kept, kept)] @ np.linalg.inv(known)
    mean, covariance = old.copy(), np.zeros((3, 3))
    mean[~kept] = new[~kept] + follow @ off
    covariance[np.ix_(kept, kept)] = was
    covariance[np.ix_(~kept, kept)] = follow @ was
    covariance[np.ix_(kept, ~kept)] = (follow @ was).T
    alone = new_covariance[np.ix_(~kept, ~kept)] - follow @ new_covariance[np.ix_(kept, ~kept)]
    covariance[np.ix_(~kept, ~kept)] = alone + follow @ was @ follow.T
    return weighed(now.structure, Predictor(*mean.tolist()), COEFFICIENTS, covariance)


def _normal(law: Weighed) -> tuple[Array, Array]:
    """Mean and covariance of input, damping and delay, shape (3,) and (3, 3)."""
    at = [list(law.stderr).index(name) for name in COEFFICIENTS]
    point = law.predictor
    return np.array([point.input, point.damping, point.delay]), law.covariance[np.ix_(at, at)]


def _with_law(model: Model, axis: str, law: Weighed) -> Model:
    """The model with a first-order law beside an axis, by which gains go."""
    nothing = dict.fromkeys(COEFFICIENTS)
    plain = Plain(None, None, None, nothing, {}, {}, law)
    return replace(model, axes={**model.axes, axis: replace(model.axes[axis], plain=plain)})


def _apart(law: AxisLaw, model: Model, axis: str) -> float:
    """Squared distance of what a law believes from what is known, if it was known as well as that."""
    mean, covariance = _normal(first_order(model, axis))
    off = np.array([law.input, law.damping, law.delay]) - mean
    return float(off @ np.linalg.solve(2.0 * covariance, off))
