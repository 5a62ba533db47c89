"""Retuning: decides, from the successive models of a vehicle in flight, when its gains should be replaced.

An axis is judged after a new fit that has settled: two fits in a row, the second from half as much data again, or the
beliefs after them, agree within the interval of the first, and the interval does not shrink faster than noise lets it.
New gains are published

- if none are in use;
- if the vehicle has changed, its new estimate has settled, and the gains in use are not safe: for more than 5 % of the
  vehicles that the interval allows they miss the margins `LOST` and `LOST_DELAY`;
- if it has not changed, but they miss these margins for more than half of those vehicles;
- if they were made for another vehicle, whose coefficients differ by more than both intervals explain, and the new
  ones are nearly as fast: slower gains are published only for the sake of margins;
- if the vehicle is known so much better that the new ones are `FASTER` times as fast.

Otherwise they stay. The ranges from `PEAK` to `LOST` and from 1 to `FASTER` are the hysteresis. Without excitation
there is no new fit, and nothing is published.

Earlier knowledge is carried over: all of an earlier model, as long as this flight tells less and does not contradict
it, and after an alarm those coefficients k that its cause leaves unchanged. Given the earlier N(m, C)_k and the new fit
N(m', C'), the other coefficients f follow the new fit, conditioned on the carried ones:

    m_f = m'_f + K (m_k - m'_k),    C_ff = C'_ff - K C'_kf + K C_kk K',    C_fk = K C_kk,    K = C'_fk (C'_kk)^-1

What the new fit says of k is not used, because both include the same flight-to-flight spread. If the new fit tells more
of k, or lies outside 99 % of what both allow, it is used alone.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtr

from rotorfit.control.control_law import AxisLaw, Kind
from rotorfit.control.loop_vehicle import has_quadratic_drag
from rotorfit.control.robustness import believed_possible, doubt, known_dynamics, share_beyond
from rotorfit.control.tuning import DELAY_SHARE, DRAWS, LATENCY, AxisTuning, Tuning, rate_note, rate_of, tune
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import structure_named
from rotorfit.core.model import (
    COEFFICIENTS,
    NORMAL,
    STRUCTURE,
    Axis,
    Model,
    Plain,
    Predictor,
    Weighed,
    first_order,
    weighed,
)

LOST = 2.0
"""Peak of the sensitivity above which the margins are lost. Source: as of `tuning.PEAK`, the upper end of its range."""

CARRIED: Mapping[str, tuple[str, ...]] = {
    "limits": ("damping", "delay"),
    "delay": ("input", "damping"),
    "payload": COEFFICIENTS,
    "thrust": COEFFICIENTS,
}
"""Cause of an alarm to the coefficients that it leaves unchanged; other causes leave none. A payload and lost thrust
change the trim of z and yaw, on which no gain depends."""

HEAVIER = "input", "delay"
"""Coefficients of x and y that a payload leaves unchanged: where their damping is drag, it falls with the mass."""

CONTRADICTED = 0.99
"""Quantile of the distance between carried knowledge and the new fit beyond which the fit is used alone."""

LOST_DELAY = 0.6 * DELAY_SHARE
"""Delay margin below which the margins are lost, as a share of the reach of the loop."""

ANEW, PROBABLY = 0.05, 0.5
"""Share of the possible vehicles without margins above which gains are replaced: after a change, and without one."""

FASTER = 1.15
"""Ratio of bandwidths from which it is worth replacing gains that keep their margins."""

SETTLED = 0.7
"""Least ratio of the standard errors of a fit to those of the fit before if it has settled: with half as much data
again, noise alone gives 0.82."""

MAY_STAY, NO_GAINS = "the gains in use may stay", "no gains keep the margins"
"""Reasons why an axis whose estimate has settled gets no new gains."""

EXPLAINED = 16.27
"""99.9 % quantile of chi-squared with 3 degrees of freedom: largest squared distance of three coefficients that both
intervals explain."""


@dataclass(frozen=True)
class Flown:
    """Gains of one axis that are in use: the law, and its bandwidth [rad/s]."""

    law: AxisLaw
    bandwidth: float


@dataclass(frozen=True)
class Retuned:
    """New gains of some axes, and the reason for each axis."""

    tuning: Tuning
    why: Mapping[str, str]


class Retuning:
    """Follows the models of one vehicle.

    Args:
        kind: Design of the gains.
        rate: Command rate [1/s]; None is `tuning.rate_of` the model at the first new gains.
        latency: Time from the exposure of a pose to the command that uses it [s].
        flown: Axis name to the gains in use; empty if they are unknown.
        before: The model of an earlier flight; None if there is none.

    Attributes:
        kept: Axis whose estimate has settled to the reason why it got no new gains at its last look.
    """

    def __init__(
        self,
        kind: Kind = "predictor",
        rate: float | None = None,
        latency: float = LATENCY,
        flown: Mapping[str, Flown] | None = None,
        before: Model | None = None,
    ) -> None:
        self._kind, self._rate, self._latency, self._asked = kind, rate, latency, rate is not None
        self._flown = dict(flown or {})
        self._fits: dict[str, tuple[Axis, Weighed, Weighed]] = {}
        known = before.axes if before else {}
        self._before = {axis: first_order(before, axis) for axis, one in known.items() if before and one.predictor}
        self._carried: dict[str, tuple[str, ...]] = dict.fromkeys(AXES, COEFFICIENTS)
        self._anew: set[str] = set()
        self.kept: dict[str, str] = {}
        self._unchanged = self._copies()

    def _copies(self) -> tuple[Any, ...]:
        """What a change alters, as it is now."""
        return dict(self._fits), dict(self._before), dict(self._carried), set(self._anew), dict(self.kept)

    def changed(self, axes: Collection[str], cause: str, revised: bool = False) -> None:
        """Notes that the vehicle has changed.

        Args:
            axes: Names of the axes that changed.
            cause: Cause of the alarm; what it leaves unchanged is still known.
            revised: Whether the last change is meant, its axes and cause now better known.
        """
        if revised:
            self._fits, self._before, self._carried, self._anew, self.kept = self._unchanged
        self._unchanged = self._copies()
        for axis in axes:
            self.kept.pop(axis, None)
            last, known = self._fits.pop(axis, None), self._carried[axis]
            if last:
                self._before[axis], known = last[2], COEFFICIENTS
            kept = HEAVIER if cause == "payload" and axis in ("x", "y") else CARRIED.get(cause, ())
            self._carried[axis] = tuple(name for name in known if name in kept)
            if self._carried[axis] != COEFFICIENTS:
                self._anew.add(axis)

    def look(self, model: Model, known: Collection[str], excited: Collection[str] = ()) -> Retuned | None:
        """New gains, if the model calls for them; else None.

        Args:
            model: The last fit of each axis.
            known: Axes whose coefficients it tells.
            excited: Axes of which it tells only some: enough if the others are carried over.
        """
        new: dict[str, AxisTuning] = {}
        why: dict[str, str] = {}
        rate = self._rate or rate_of(model)
        for axis in (axis for axis in AXES if axis in known or axis in excited):
            belief = self._settled(model, axis, axis in known)
            if belief is None:
                continue
            believed = _with_law(model, axis, belief)
            self.kept[axis] = NO_GAINS
            if fresh := self._tuned(believed, axis, rate):
                self.kept[axis] = MAY_STAY
                reason = self._reason(believed, axis, fresh)
                if reason:
                    new[axis], why[axis] = fresh, reason
                    self._flown[axis] = Flown(fresh.law, fresh.bandwidth)
        if not new:
            return None
        self._rate = rate
        note = rate_note(model, rate, self._asked)
        return Retuned(Tuning(self._kind, rate, self._latency, new, {}, note), why)

    def _settled(self, model: Model, axis: str, known: bool) -> Weighed | None:
        """The belief about an axis, if there is a new fit and it has settled; else None."""
        before = self._fits.get(axis)
        if model.axes[axis].predictor is None or (before and _is_same_fit(before[0], model.axes[axis])):
            return None
        fit = first_order(model, axis)
        now = fit if _is_dragged(model, axis) else self._belief(axis, fit)  # what is carried over knows no hover
        if not known and now is fit:
            return None
        self._fits[axis] = model.axes[axis], fit, now
        if before is None:
            return None
        return now if (known and _same(before[1], fit)) or _same(before[2], now) else None

    def _belief(self, axis: str, now: Weighed) -> Weighed:
        """The belief about an axis: the last fit, combined with what is carried over."""
        before = self._before.get(axis)
        return now if before is None else _carried_over(before, now, self._carried[axis])

    def _tuned(self, model: Model, axis: str, rate: float) -> AxisTuning | None:
        """Gains for an axis; None if none keep the margins."""
        try:
            return tune(model, self._kind, rate=rate, latency=self._latency, axes=(axis,)).axes[axis]
        except ModelError:
            return None

    def _reason(self, model: Model, axis: str, fresh: AxisTuning) -> str:
        """The reason for new gains; empty if those in use may stay."""
        anew, flown = axis in self._anew, self._flown.get(axis)
        self._anew.discard(axis)
        if flown is None:
            return "the first, as its estimate has settled"
        vehicles = doubt(believed_possible(model, axis, DRAWS, 0), flown.law.period, self._latency, 0)
        lost = share_beyond(flown.law, vehicles, LOST, LOST_DELAY * flown.law.reach)
        if lost > (ANEW if anew else PROBABLY):
            since = "the vehicle has changed: " if anew else ""
            return f"{since}those flown keep no margins for {100 * lost:.0f} % of what it may be"
        if _apart(flown.law, model, axis) > EXPLAINED and FASTER * fresh.bandwidth >= flown.bandwidth:
            return "those flown are for another vehicle than its interval allows"
        if fresh.bandwidth >= FASTER * flown.bandwidth:
            return f"the vehicle is known better: {fresh.bandwidth / flown.bandwidth:.1f} times as fast"
        return ""


def _is_same_fit(old: Axis, now: Axis) -> bool:
    """Whether two axes have their numbers from one fit; their trims may be told for other flights beside it."""
    return old.predictor == now.predictor and old.stderr == now.stderr


def _same(old: Weighed, now: Weighed) -> bool:
    """Whether a law lies in the 95 % intervals of the one before, and its standard errors have settled."""
    if any(name not in law.stderr for law in (old, now) for name in COEFFICIENTS):
        return False
    return all(
        abs(getattr(now.predictor, name) - getattr(old.predictor, name)) <= NORMAL * old.stderr[name]
        and now.stderr[name] >= SETTLED * old.stderr[name]
        for name in COEFFICIENTS
    )


def _carried_over(before: Weighed, now: Weighed, names: Collection[str]) -> Weighed:
    """A fit, with some coefficients as they were known before; the fit alone if it tells more or contradicts them."""
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
    """The model with a first-order law beside an axis, from which its gains are made.

    Where that is not the law of the fit, it is all that is known of the vehicle, and the margins are its own, too.
    """
    nothing = dict.fromkeys(COEFFICIENTS)
    plain = Plain(None, None, None, nothing, {}, dict.fromkeys(COEFFICIENTS, "ok"), law)  # what has settled is known
    known = replace(model.axes[axis], plain=plain)
    if law != first_order(model, axis):
        known = replace(known, structure=STRUCTURE, laws=(), predictor=law.predictor, ci95={})
    return replace(model, axes={**model.axes, axis: known})


def _apart(law: AxisLaw, model: Model, axis: str) -> float:
    """Squared distance of the vehicle that a law assumes from the known one, taking both as equally uncertain."""
    mean, covariance = _normal(first_order(model, axis))
    if _is_dragged(model, axis):  # gains are those at hover
        mean = np.array(known_dynamics(model, axis))
        covariance = np.cov(np.array(believed_possible(model, axis, DRAWS, 0)).T)
    off = np.array([law.input, law.damping, law.delay]) - mean
    return float(off @ np.linalg.pinv(2.0 * covariance, hermitian=True) @ off)  # a damping at its bound does not vary


def _is_dragged(model: Model, axis: str) -> bool:
    return has_quadratic_drag(structure_named(model.axes[axis].structure))
