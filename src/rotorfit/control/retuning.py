"""Retuning: when the gains that are flown are to be others, from one model after the other of a vehicle in flight.

An axis is looked at where a fit says something new of it and the vehicle's interval has settled: two fits in a row, the
second of half as much data again, agree within the interval of the first, and it does not shrink faster than noise
lets it. New gains are published

- where none are flown;
- where the vehicle has changed, its new self has settled, and those that are flown do not hold for all of it: for more
  than 5 % of what its interval allows they leave less than `LOST` and `LOST_DELAY`;
- where it has not changed, but they probably do not hold: the same for more than half of it;
- where they are for another vehicle: its coefficients lie outside of what both intervals explain;
- where the vehicle is known so much better that they would be `FASTER` times as fast.

Otherwise they stay, so that gains from a flight that told more are not given up because this one tells less. What lies
between `PEAK` and `LOST`, and between 1 and `FASTER`, is the hysteresis. Without excitation there is no new fit, and
nothing is published.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from rotorfit.control.control_law import AxisLaw, Kind
from rotorfit.control.robustness import believed_possible, doubt, known_dynamics, share_beyond
from rotorfit.control.tuning import DELAY_SHARE, DRAWS, LATENCY, RATE, AxisTuning, Tuning, tune
from rotorfit.core.errors import ModelError
from rotorfit.core.model import COEFFICIENTS, Axis, Model, Weighed, first_order

LOST = 2.0
"""Peak of the sensitivity from which a margin is lost. Source: as of `tuning.PEAK`: the upper end of what loops are
tuned to."""

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
    """

    def __init__(
        self,
        kind: Kind = "predictor",
        rate: float = RATE,
        latency: float = LATENCY,
        flown: Mapping[str, Flown] | None = None,
    ) -> None:
        self._kind, self._rate, self._latency = kind, rate, latency
        self._flown = dict(flown or {})
        self._fits: dict[str, tuple[Axis, Weighed]] = {}
        self._anew: set[str] = set()

    def changed(self, axes: Collection[str]) -> None:
        """Some axes are of another vehicle from now on: what was fitted before says nothing of them."""
        self._anew |= set(axes)
        for axis in axes:
            self._fits.pop(axis, None)

    def look(self, model: Model, axes: Collection[str]) -> Retuned | None:
        """New gains, where the model calls for them.

        Args:
            model: As of the last fit of each axis.
            axes: Those that it is known of.
        """
        new: dict[str, AxisTuning] = {}
        why: dict[str, str] = {}
        for axis in axes:
            if self._settled(model, axis) and (fresh := self._tuned(model, axis)):
                reason = self._reason(model, axis, fresh)
                if reason:
                    new[axis], why[axis] = fresh, reason
                    self._flown[axis] = Flown(fresh.law, fresh.bandwidth)
        return Retuned(Tuning(self._kind, self._rate, self._latency, new, {}), why) if new else None

    def _settled(self, model: Model, axis: str) -> bool:
        """Whether there is a new fit, which says the same as the one before, and not much more."""
        before, now = self._fits.get(axis), first_order(model, axis)
        if before and before[0] is model.axes[axis]:
            return False
        self._fits[axis] = model.axes[axis], now
        if before is None or any(name not in now.stderr or name not in before[1].stderr for name in COEFFICIENTS):
            return False
        old = before[1]
        return all(
            abs(getattr(now.predictor, name) - getattr(old.predictor, name)) <= AGREES * old.stderr[name]
            and now.stderr[name] >= SETTLED * old.stderr[name]
            for name in COEFFICIENTS
        )

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
        if _apart(flown.law, model, axis) > EXPLAINED:
            return "those flown are for another vehicle than its interval allows"
        if fresh.bandwidth >= FASTER * flown.bandwidth:
            return f"the vehicle is known better: {fresh.bandwidth / flown.bandwidth:.1f} times as fast"
        return ""


def _apart(law: AxisLaw, model: Model, axis: str) -> float:
    """Squared distance of what a law believes from what is known, if it was known as well as that."""
    now = first_order(model, axis)
    at = [list(now.stderr).index(name) for name in COEFFICIENTS]
    off = np.array([law.input, law.damping, law.delay]) - np.array(known_dynamics(model, axis))
    return float(off @ np.linalg.solve(2.0 * now.covariance[np.ix_(at, at)], off))
