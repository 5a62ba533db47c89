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

Earlier knowledge is carried over: all of an earlier model, as long as this flight tells less and contradicts it on no
axis, and after an alarm those coefficients k that its cause leaves unchanged. Where that is all of them, the vehicle is
believed to be that of the earlier model, under its own law. Else, given the earlier N(m, C)_k and the new fit N(m', C')
under the same law, the other parameters f follow the new fit, conditioned on the carried ones:

    m_f = m'_f + K (m_k - m'_k),    C_ff = C'_ff - K C'_kf + K C_kk K',    C_fk = K C_kk,    K = C'_fk (C'_kk)^-1

What the new fit says of k is not used, because both include the same flight-to-flight spread. A lag goes with the
delay. Each law that both allow is combined, with the product of its weights. If the new fit tells more of k, lies
outside 99 % of what both allow, or has another law than the earlier one, it is used alone.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtr

from rotorfit.control.control_law import AxisLaw, Kind
from rotorfit.control.loop_vehicle import differs_at_hover, first_order_about
from rotorfit.control.robustness import believed_possible, doubt, known_dynamics, share_beyond
from rotorfit.control.tuning import DELAY_SHARE, DRAWS, LATENCY, AxisTuning, Tuning, rate_note, rate_of, tune
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import structure_named
from rotorfit.core.model import (
    COEFFICIENTS,
    NORMAL,
    Axis,
    Model,
    Plain,
    Predictor,
    Weighed,
    first_order,
    laws_of_vehicle,
    predictor_of,
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


@dataclass(frozen=True)
class _Belief:
    """What an axis is believed to be.

    Attributes:
        axis: Its name.
        model: A model in which it is that, under each law that it may have.
        carried: The coefficients that are carried over; empty for a fit alone.
        earlier: Whether they are from the model of an earlier flight.
    """

    axis: str
    model: Model
    carried: tuple[str, ...] = ()
    earlier: bool = False

    @property
    def plain(self) -> Weighed:
        """The axis as a first-order law with a delay."""
        return first_order(self.model, self.axis)


class Retuning:
    """Follows the models of one vehicle.

    Args:
        kind: Design of the gains.
        rate: Command rate [1/s]; None is `tuning.rate_of` the model at the first new gains.
        latency: Time from the exposure of a pose to the command that uses it [s].
        flown: Axis name to the gains in use; empty if they are unknown.
        before: The model of an earlier flight; None if there is none.
        name: What that is called.

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
        name: str = "the earlier model",
    ) -> None:
        self._name, self._another = name, False
        self._kind, self._rate, self._latency, self._asked = kind, rate, latency, rate is not None
        self._flown = dict(flown or {})
        self._fits: dict[str, tuple[Axis, _Belief, _Belief]] = {}
        known = before.axes if before else {}
        self._before = {
            axis: _Belief(axis, before, earlier=True) for axis, one in known.items() if before and one.predictor
        }
        self._carried: dict[str, tuple[str, ...]] = dict.fromkeys(AXES, COEFFICIENTS)
        self._anew: set[str] = set()
        self._withheld: dict[str, _Belief] = {}
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
            self._withheld.pop(axis, None)
            last, known = self._fits.pop(axis, None), self._carried[axis]
            if last:
                _, fit, belief = last
                self._before[axis], known = fit if belief.earlier and self._another else belief, COEFFICIENTS
            kept = HEAVIER if cause == "payload" and axis in ("x", "y") else CARRIED.get(cause, ())
            self._carried[axis] = tuple(name for name in known if name in kept)
            if self._carried[axis] != COEFFICIENTS:
                self._anew.add(axis)

    def another(self) -> None:
        """Notes that the vehicle is not that of the earlier flight, of which nothing is carried over any more."""
        self._another = True
        self._anew |= self._flown.keys()
        self.kept.clear()
        self._withheld.clear()
        fits, before, carried, anew, _ = self._unchanged  # a revision takes nothing of it back
        self._unchanged = fits, before, carried, anew | self._flown.keys(), {}

    def retuned(self, axes: Iterable[str]) -> None:
        """Notes that the gains in use of some axes were made after their last change."""
        self._anew.difference_update(axes)

    def look(
        self,
        model: Model,
        known: Collection[str],
        excited: Collection[str] = (),
        doubted: bool = False,
        withheld: Collection[str] = (),
    ) -> Retuned | None:
        """New gains, if the model calls for them; else None.

        Args:
            model: The last fit of each axis.
            known: Axes whose coefficients it tells.
            excited: Axes of which it tells only some: enough if the others are carried over.
            doubted: Whether this flight contradicts the earlier one on any axis: then nothing of that is carried over.
            withheld: Axes that are not tuned for now, but later by estimates that have settled meanwhile.
        """
        new: dict[str, AxisTuning] = {}
        why: dict[str, str] = {}
        rate = self._rate or rate_of(model)
        for axis in (axis for axis in AXES if axis in known or axis in excited):
            fit, waited = self._fits.get(axis), self._withheld.pop(axis, None)
            belief = self._settled(model, axis, axis in known, doubted)
            if belief is None and self._fits.get(axis) is fit:  # nothing new denies what has waited
                belief = waited
            if belief and axis in withheld:
                self._withheld[axis] = belief
            if belief is None or axis in withheld:
                continue
            self.kept[axis] = NO_GAINS
            if fresh := self._tuned(belief.model, axis, rate):
                self.kept[axis] = MAY_STAY
                reason = self._reason(belief, fresh)
                if reason:
                    new[axis], why[axis] = fresh, reason
                    self._flown[axis] = Flown(fresh.law, fresh.bandwidth)
        if not new:
            return None
        self._rate = rate
        note = rate_note(model, rate, self._asked)
        return Retuned(Tuning(self._kind, rate, self._latency, new, {}, note), why)

    def _settled(self, model: Model, axis: str, known: bool, doubted: bool) -> _Belief | None:
        """The belief about an axis, if there is a new fit and it has settled; else None."""
        before = self._fits.get(axis)
        if model.axes[axis].predictor is None or (before and _is_same_fit(before[0], model.axes[axis])):
            return None
        fit = _Belief(axis, _as_settled(model, axis))
        now = self._belief(fit, doubted)
        if not known and now is fit:
            return None
        self._fits[axis] = model.axes[axis], fit, now
        if before is None:
            return None
        return now if (known and _same(before[1].plain, fit.plain)) or _same(before[2].plain, now.plain) else None

    def _belief(self, fit: _Belief, doubted: bool) -> _Belief:
        """The belief about an axis: its last fit, with what is carried over."""
        before, names = self._before.get(fit.axis), self._carried[fit.axis]
        if before is None or (before.earlier and (doubted or self._another)):
            return fit
        if _differs_at_hover(fit.model, fit.axis):
            return fit  # what is carried over knows no hover
        believed = _carried_over(before.model, fit.model, fit.axis, names)
        return _Belief(fit.axis, believed, names, before.earlier) if believed else fit

    def _tuned(self, model: Model, axis: str, rate: float) -> AxisTuning | None:
        """Gains for an axis; None if none keep the margins."""
        try:
            return tune(model, self._kind, rate=rate, latency=self._latency, axes=(axis,)).axes[axis]
        except ModelError:
            return None

    def _reason(self, belief: _Belief, fresh: AxisTuning) -> str:
        """The reason for new gains, and what is carried over in them; empty if those in use may stay."""
        reason = self._why(belief.model, belief.axis, fresh)
        if not reason or not belief.carried:
            return reason
        names = " and ".join(belief.carried) if len(belief.carried) < 3 else "input, damping and delay"
        whose = f"{self._name}, which this flight does not contradict" if belief.earlier else "before the change"
        return f"{reason}; {names} {'is' if len(belief.carried) == 1 else 'are'} from {whose}"

    def _why(self, model: Model, axis: str, fresh: AxisTuning) -> str:
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


def _carried_over(before: Model, now: Model, axis: str, names: Collection[str]) -> Model | None:
    """The last fit of an axis, with some coefficients as they were known before.

    None if the fit tells more of them, contradicts them, or has another law: a lag that one of both knows must not be
    lost, as the margins depend on it.
    """
    was, fit = first_order(before, axis), first_order(now, axis)
    if not names or any(name not in law.stderr for law in (was, fit) for name in COEFFICIENTS):
        return None
    kept = np.array([name in names for name in COEFFICIENTS])
    (old, old_covariance), (new, new_covariance) = _normal(was), _normal(fit)
    known, own = (each[np.ix_(kept, kept)] for each in (old_covariance, new_covariance))
    off = old[kept] - new[kept]
    apart = float(off @ np.linalg.solve(known + own, off))
    if np.linalg.det(own) <= np.linalg.det(known) or chdtr(kept.sum(), apart) > CONTRADICTED:
        return None
    both = [{law.structure: law for law in laws_of_vehicle(model, axis)} for model in (before, now)]
    shared = both[0].keys() & both[1].keys()
    if kept.all():
        known_of = [set(predictor_of(model, axis).extra) for model in (before, now)]
        lost = not shared and known_of[1] - known_of[0]
        return None if lost else replace(before, findings=(*before.findings, *now.findings))
    if any(next(iter(laws)) not in shared for laws in both):
        return None
    pairs = [(both[0][name], law) for name, law in both[1].items() if name in both[0]]
    if any(one.stderr.keys() != {*COEFFICIENTS, *one.predictor.extra} for pair in pairs for one in pair):
        return None
    return _with_laws(now, axis, [_combined(*pair, names) for pair in pairs], _combined(was, fit, names))


def _combined(before: Weighed, now: Weighed, names: Collection[str]) -> Weighed:
    """A law of a fit, with some coefficients as they were known before; what else makes it late is as its delay.

    A lag or zero that follows them out of its range is at the end of that.
    """
    every = (*COEFFICIENTS, *now.predictor.extra)
    (old, old_covariance), (new, new_covariance) = _normal(before, every), _normal(now, every)
    kept = np.array([(name if name in COEFFICIENTS else "delay") in names for name in every])
    was, known = old_covariance[np.ix_(kept, kept)], new_covariance[np.ix_(kept, kept)]
    follow = new_covariance[np.ix_(~kept, kept)] @ np.linalg.inv(known)
    mean, covariance = old.copy(), np.zeros_like(old_covariance)
    mean[~kept] = new[~kept] + follow @ (old[kept] - new[kept])
    covariance[np.ix_(kept, kept)] = was
    covariance[np.ix_(~kept, kept)] = follow @ was
    covariance[np.ix_(kept, ~kept)] = (follow @ was).T
    alone = new_covariance[np.ix_(~kept, ~kept)] - follow @ new_covariance[np.ix_(kept, ~kept)]
    covariance[np.ix_(~kept, ~kept)] = alone + follow @ was @ follow.T
    g, b, tau, *others = mean.tolist()
    ends = {one.name: (one.low, one.high) for one in structure_named(now.structure).extras}
    extra = {name: float(np.clip(value, *ends[name])) for name, value in zip(every[3:], others, strict=True)}
    point = Predictor(g, b, tau, extra)
    return weighed(now.structure, point, every, covariance, before.weight * now.weight)


def _normal(law: Weighed, names: Sequence[str] = COEFFICIENTS) -> tuple[Array, Array]:
    """Mean and covariance of the named parameters, by default input, damping and delay, shape (n,) and (n, n)."""
    at = [list(law.stderr).index(name) for name in names]
    point = law.predictor
    known = {"input": point.input, "damping": point.damping, "delay": point.delay, **point.extra}
    return np.array([known[name] for name in names]), law.covariance[np.ix_(at, at)]


def _with_laws(model: Model, axis: str, laws: Sequence[Weighed], plain: Weighed) -> Model:
    """The model, with an axis that is known by these laws alone, and as a first-order one by `plain`."""
    own, *others = sorted(laws, key=lambda law: -law.weight)
    known = replace(
        _as_settled(model, axis, plain).axes[axis],
        structure=own.structure,
        predictor=own.predictor,
        laws=(own, *others),
        status=dict.fromkeys(own.stderr, "ok"),
        ci95={},
        combinations={},
    )
    names = tuple(f"{axis}.{name}" for name in own.stderr)
    return replace(model, axes={**model.axes, axis: known}, covariance_names=names, covariance=own.covariance)


def _as_settled(model: Model, axis: str, law: Weighed | None = None) -> Model:
    """The model with a first-order law beside an axis, from which its gains are made; by default its own."""
    nothing = dict.fromkeys(COEFFICIENTS)
    law = law or first_order(model, axis)
    plain = Plain(None, None, None, nothing, {}, dict.fromkeys(COEFFICIENTS, "ok"), law)  # what has settled is known
    return replace(model, axes={**model.axes, axis: replace(model.axes[axis], plain=plain)})


def _apart(law: AxisLaw, model: Model, axis: str) -> float:
    """Squared distance of the vehicle that a law assumes from the known one, taking both as equally uncertain."""
    mean, covariance = _normal(first_order(model, axis))
    if _differs_at_hover(model, axis):  # gains are those at hover
        mean = np.array(known_dynamics(model, axis))
        drawn = [first_order_about(one) for one in believed_possible(model, axis, DRAWS, 0)]
        covariance = np.cov(np.array(drawn).T)
    off = np.array([law.input, law.damping, law.delay]) - mean
    return float(off @ np.linalg.pinv(2.0 * covariance, hermitian=True) @ off)  # a damping at its bound does not vary


def _differs_at_hover(model: Model, axis: str) -> bool:
    return differs_at_hover(structure_named(model.axes[axis].structure))
