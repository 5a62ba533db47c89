"""The default laws: delay and lag with a weak prior on the lag, or second order with a zero where the data require it.

Between command and acceleration of x and y is the attitude loop: a lag in addition to the delay. Where the vehicle
turns, the lagged acceleration turns with the heading, as that of commanded angles does, or it keeps its direction in
the world, as that of a velocity loop does: the data decide. A velocity loop, on axes that have one, overshoots: its
integral part gives a second order, its feed-forward a zero. A fast attitude loop is indistinguishable from a delay. The
laws are weighted by their evidence; where several remain, the published intervals of an axis contain those of all.

Source: J. A. Hoeting et al., Statistical Science 14 (1999), pp. 382-417 (averaging over models).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from rotorfit.core.card import Prior
from rotorfit.core.flight_data import Flight
from rotorfit.core.laws import LAG, STRUCTURES, Extra, Structure, level_range, structure_named
from rotorfit.core.model import COEFFICIENTS, Axis, Combination, Predictor, Weighed, weighed
from rotorfit.estimation.likelihood.axis_estimate import Estimate, maximise_restricted
from rotorfit.estimation.likelihood.coefficients import covariances, statuses, unfinished
from rotorfit.estimation.likelihood.estimand import hull
from rotorfit.estimation.likelihood.extra_parameters import estimated_extras, extra_status, structure_at
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, approached
from rotorfit.estimation.likelihood.law_selection import effective_samples
from rotorfit.estimation.likelihood.optima import ALIKE, is_inverse_loop, prediction_error
from rotorfit.estimation.likelihood.prior import LAG_MEDIAN, LAG_SPREAD, GaussianPrior, gaussian_prior, lag_prior
from rotorfit.estimation.likelihood.richer_laws import (
    Hopeless,
    PriorOf,
    estimate_laws,
    finished,
    never,
    under_law,
)

LAGGED, WORLD, LED = (
    STRUCTURES[name] for name in ("first_order_delay_lag", "first_order_delay_world_lag", "second_order_zero")
)
"""The laws of the family besides the first-order law with a delay."""

WITH_LOOP = ("z", "yaw")
"""Axes that may have a velocity loop."""

FAST = np.log([100.0, 0.05])
"""Logarithms of damping [1/s] and overlap of a fast disturbance."""

ZERO_MEAN = 0.3
"""Mean of the exponential prior of the zero [s]; it affects the weights of the laws and no estimate."""

NO_ZERO = 0.005
"""Zero below which a law counts as having none [s]: such a zero has the same effect as a change of the delay."""

ROUNDING = 1e-9
"""Lower limit of a conditional variance relative to the marginal one: below it is rounding."""

OTHER_MAXIMUM = 1.0
"""Smallest rise of the log-likelihood for which a maximum at other levels takes the place of the first."""

LIKELIER = 0.05
"""Smallest rise of the log-likelihood for which a climb from other levels counts: below it is the climbs' tolerance."""

LEAST_WEIGHT = 0.1
"""Weight below which a law is left out: strong evidence against it (Kass and Raftery, odds of 10)."""

BY_CHANCE = 20.0
"""Rise of the log-likelihood by a slow pole and a zero beyond which the pair is no drift: on some 220 simulated
first-order axes whose pose drifts it was 12 at most, on 16 with such a pair 22 at least."""

PROMISED, SPARE = 3.0, 1.0
"""How many times the expected gain of one step, and how much in addition, the rest of a climb may add to the evidence:
more than any did to a law that had fallen behind."""


@dataclass(frozen=True)
class Law:
    """A law of the family on one axis, and its weight."""

    estimate: Estimate
    weight: float


@dataclass(frozen=True)
class Family:
    """The default laws of one axis.

    Attributes:
        plain: Estimate under the first-order law with a delay, tried also from the levels of a likelier law.
        laws: The laws that the data do not rule out, by decreasing weight.
        beside: The likeliest law without a zero that was left out for its weight, where all that were kept have one and
            its log-likelihood is lower by no more than `BY_CHANCE`.
    """

    plain: Estimate
    laws: tuple[Law, ...]
    beside: Law | None = None

    def of(self, laws: Sequence[Law]) -> "Family":
        """The family with only these of its laws, one or more; their weights are normalised."""
        total = sum(law.weight for law in laws)
        return replace(self, laws=tuple(replace(law, weight=law.weight / total) for law in laws))

    def with_other_reading(self, axes: Sequence[Axis]) -> "Family":
        """The family with the law beside it where the zero may cancel the slow pole; `axes` as under each of its laws.

        What is left of such a law is a first-order one with the damping 1 / lag, and input and damping name the
        cancelled pole. The pair is a slow drift that the commands happen to explain: its likelihood rests on a few
        swings of wind and pose, and on the disturbance having their spectrum, which drift of the pose denies.
        """
        return self.of((*self.laws, self.beside)) if self.beside and any(map(_may_cancel, axes)) else self


def _may_cancel(axis: Axis) -> bool:
    """Whether the poles of a law with a zero are real and the interval of the zero holds the slow one's time constant.

    The poles of the recorded velocity loops that overshoot are complex.
    """
    if axis.predictor is None or "zero" not in axis.ci95:
        return False
    lag, (low, high) = axis.predictor.extra["lag"], axis.ci95["zero"]
    real = 1 - 4 * lag * axis.predictor.damping
    if real < 0:
        return False
    slow = 2 * lag / (1 - real**0.5)
    return (low or 0.0) <= slow and (high is None or slow <= high)


def families(
    serving: Sequence[Flight], estimates: Mapping[str, Estimate], priors: Mapping[str, Mapping[str, Prior]]
) -> dict[str, Family]:
    """The default laws of the axes of one group; arguments as for `default_laws`."""
    return {
        axis: _family(serving, plain, richer)
        for axis, (plain, *richer) in default_laws(serving, estimates, priors, _cannot_hold).items()
    }


def _family(serving: Sequence[Flight], plain: Estimate, richer: Sequence[Estimate]) -> Family:
    """The laws of one axis, weighed; where the others cannot hold, what they predict is of no account."""
    if all(_cannot_hold(plain, one) for one in richer):
        plain = no_worse(plain, richer)
        return Family(plain, (Law(plain, 1.0),))
    return _weighed(plain, _needed(serving, plain, richer))


def _cannot_hold(plain: Estimate, richer: Estimate) -> bool:
    """Whether the weight of a law will be below `LEAST_WEIGHT`, however the rest of its climb ends.

    The average of its likelihood changes little where lag and zero only trade against each other, which is where climbs
    are long.
    """
    share = effective_samples(max((plain, richer), key=lambda one: one.optimum.score.log_likelihood))[1]
    most = _evidence(richer, share) + PROMISED * richer.optimum.promise + SPARE
    return most < _evidence(plain, share) + float(np.log(LEAST_WEIGHT))


def default_laws(
    serving: Sequence[Flight],
    estimates: Mapping[str, Estimate],
    priors: Mapping[str, Mapping[str, Prior]],
    hopeless: Callable[[Estimate, Estimate], bool] = lambda _plain, _richer: False,
) -> dict[str, tuple[Estimate, ...]]:
    """The maximum of every default law that an axis may have, the first-order law with a delay first.

    Args:
        serving: The flights of the group.
        estimates: Estimates under the first-order law with a delay, by axis.
        priors: Priors of the card by axis and coefficient; empty to use none.
        hopeless: Whether the climb of a law, compared with the first-order law, is given up; the law stays where its
            climb stood. A law from which another starts is always climbed, and so is one beside a law that may hold.
    """

    def prior_of(axes: Sequence[str], structures: Sequence[Structure]) -> GaussianPrior | None:
        return lag_prior(structures, gaussian_prior(priors, axes))

    group = tuple(estimates)
    estimates = _relevelled(estimates)

    def given_up(axes: Sequence[str], begun: Optimum) -> bool:
        known = [(k, estimates[axis]) for k, axis in enumerate(axes) if estimates[axis].excited]
        return all(hopeless(plain, replace(plain, optimum=begun, place=k)) for k, plain in known)

    lagged = estimate_laws(serving, estimates, dict.fromkeys(group, LAGGED), prior_of, given_up)
    turned = _in_world(lagged, prior_of, given_up)
    out: dict[str, tuple[Estimate, ...]] = {}
    for axis, plain in estimates.items():
        out[axis] = (plain, lagged[axis]) if plain.excited else (plain,)
        if axis in turned:
            out[axis] += (turned[axis],)
        if plain.excited and axis in WITH_LOOP:
            alone = hopeless(plain, lagged[axis])  # a law that holds is weighed by the innovations of the likeliest one
            out[axis] += (_led(axis, lagged[axis], plain, prior_of, given_up if alone else never),)
    return out


def _in_world(lagged: Mapping[str, Estimate], prior_of: PriorOf, given_up: Hopeless) -> dict[str, Estimate]:
    """x and y with a lag in the world frame, climbed from where a lag in the heading frame ended, if they turn."""
    first = next(iter(lagged.values()))
    point, group = first.optimum.point, tuple(lagged)
    if LAGGED not in point.structures or point.gain.size == 1:
        return {}
    laws = tuple(WORLD if one == LAGGED else one for one in point.structures)
    moving = [lagged[axis].excited for axis in group]
    optimum = finished(first.records, replace(point, structures=laws), moving, prior_of(group, laws), given_up)
    return {axis: replace(one, optimum=optimum) for axis, one in lagged.items() if one.excited}


def _relevelled(estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """The estimates climbed again from a fast disturbance, where that is likelier: the levels can have two maxima.

    With little wind and pose noise the residuals are errors of the law: smooth over a short time, uncorrelated beyond.
    """
    found: dict[int, Optimum] = {}
    for estimate in estimates.values():
        optimum = estimate.optimum
        levels = optimum.point.levels.copy()
        velocity = levels[:, 0] - levels[:, 3] - 3 * levels[:, 2]  # logarithm of half its variance
        levels[:, 2], levels[:, 3] = FAST
        levels[:, 0] = velocity + levels[:, 3] + 3 * levels[:, 2]
        levels = np.clip(levels, *level_range(optimum.point.measured).T)
        start = replace(optimum.point, levels=levels)
        K = optimum.point.gain.size
        moving = [bool(optimum.free[k]) for k in range(K)]
        if id(optimum) not in found:
            start = approached(estimate.records, start, optimum.free, optimum.prior)
            least = optimum.score.log_likelihood + OTHER_MAXIMUM
            again = maximise_restricted(estimate.records, start, moving, optimum.prior, partial(_stays_below, least))
            better = again.score.log_likelihood > least and not _inverted(again)
            found[id(optimum)] = again if better else optimum
    return {axis: replace(estimate, optimum=found[id(estimate.optimum)]) for axis, estimate in estimates.items()}


def _stays_below(least: float, first: Optimum) -> bool:
    """Whether the second climb to a maximum cannot raise the log-likelihood of the first to `least`."""
    return first.score.log_likelihood + PROMISED * first.promise + 0.5 * OTHER_MAXIMUM < least


def _led(axis: str, lagged: Estimate, plain: Estimate, prior_of: PriorOf, given_up: Hopeless) -> Estimate:
    """The law with a zero, climbed from the levels of the likelier of the other two."""
    better = max((lagged, plain), key=lambda one: one.optimum.score.log_likelihood)
    levels = replace(plain.optimum, point=replace(plain.optimum.point, levels=better.optimum.point.levels))
    return under_law(replace(plain, optimum=levels), axis, LED, prior_of, given_up)


def _needed(serving: Sequence[Flight], plain: Estimate, richer: Sequence[Estimate]) -> list[Estimate]:
    """The laws with a lag that predict no worse than any simpler one, without a law with a zero that needs none.

    With a lag near 0 a law is the first-order law at whichever of its optima is likeliest, also at one that the search
    has left out because it predicts worse, or because it is a loop identified backwards.
    """
    laws = (plain, *richer) if richer else ()
    errors = [prediction_error(serving, one.records[0].axes, one.optimum)[0][one.place] for one in laws]
    return [
        law
        for place, law in enumerate(laws)
        if place
        and not _inverted(law.optimum)
        and not (structure_at(law.optimum, law.place) == LED and _moves_as_lagged(law))
        and not any(errors[place] > (1 + ALIKE) * simpler for simpler in errors[:place])
    ]


def _moves_as_lagged(led: Estimate) -> bool:
    """Whether there is no zero and the poles are real: then the law equals a first-order law with a lag."""
    value, k = led.optimum.point.extra_values(led.place), led.place
    overdamped = 4 * value["lag"] * float(np.exp(led.optimum.point.log_damping[k])) <= 1
    return overdamped and value["zero"] < NO_ZERO


def _weighed(plain: Estimate, tried: Sequence[Estimate]) -> Family:
    """The laws with their posterior weights, prior weights being equal; laws whose climb has not ended are left out."""
    ended = [one for one in tried if not unfinished(one.optimum, one.place)]
    plain = no_worse(plain, ended)
    if not ended:
        return Family(plain, (Law(plain, 1.0),))
    laws = [plain, *ended]
    share = effective_samples(max(laws, key=lambda one: one.optimum.score.log_likelihood))[1]
    lagged = sum(structure_at(one.optimum, one.place).order == 1 for one in laws)  # two frames share one prior weight
    evidence = np.array([
        _evidence(one, share) - (np.log(lagged) if structure_at(one.optimum, one.place).order == 1 else 0.0)
        for one in laws
    ])  # fmt: skip
    weight = np.exp(evidence - evidence.max())
    kept = np.where(weight < LEAST_WEIGHT * weight.sum(), 0.0, weight)
    order, total = np.argsort(-weight, kind="stable"), kept.sum()
    told = tuple(Law(laws[i], float(kept[i] / total)) for i in order if kept[i] > 0)
    simpler = next(i for i in order if structure_at(laws[i].optimum, laws[i].place) != LED)
    lost = max(one.optimum.score.log_likelihood for one in laws) - laws[simpler].optimum.score.log_likelihood
    if kept[simpler] > 0 or lost > BY_CHANCE:
        return Family(plain, told)
    return Family(plain, told, Law(laws[simpler], float(weight[simpler] / total)))


def _evidence(estimate: Estimate, share: float) -> float:
    """Logarithm of the likelihood averaged over the priors of lag and zero, by Laplace's method, one after the other.

    Input, damping and delay belong to every law and are taken at the maximum. `share` scales the log-likelihood to the
    effective number of independent innovations. An average cannot exceed the maximum: the factor is limited to 1, since
    a zero and the delay may be equivalent, with a meaningless variance. Where lag and zero are correlated, as where
    they cancel each other, the second one has its variance conditional on the first.

    Source: R. E. Kass, A. E. Raftery, J. Amer. Statist. Assoc. 90 (1995), pp. 773-795, section 4.1.
    """
    optimum, k = estimate.optimum, estimate.place
    extras, values = estimated_extras(optimum, k), optimum.point.extra_values(k)
    at = [optimum.point.place(extra.name, k) for extra in extras]
    covariance = optimum.covariance[np.ix_(at, at)] / share
    spent = 0.0
    for i, extra in enumerate(extras):
        known = covariance[i, :i] @ np.linalg.pinv(covariance[:i, :i], hermitian=True) @ covariance[:i, i]
        left = max(covariance[i, i] - known, ROUNDING * covariance[i, i])
        spent += min(_log_prior(extra, values[extra.name]) + 0.5 * float(np.log(2 * np.pi * left)), 0.0)
    return share * optimum.score.log_likelihood + spent


def _log_prior(extra: Extra, value: float) -> float:
    """Logarithm of the prior density of a further parameter, in the coordinate of the estimator."""
    if extra.place == LAG:
        off = np.log(value / LAG_MEDIAN) / LAG_SPREAD
        return float(-0.5 * off**2 - np.log(LAG_SPREAD * np.sqrt(2 * np.pi)))
    return -value / ZERO_MEAN - float(np.log(ZERO_MEAN))


def no_worse(plain: Estimate, others: Sequence[Estimate]) -> Estimate:
    """The first-order law climbed again from the levels of a likelier law, where that is higher by `LIKELIER`."""
    best = max((plain, *others), key=lambda one: one.optimum.score.log_likelihood)
    if best is plain or plain.optimum.point.gain.size > 1:
        return plain
    start = replace(plain.optimum.point, levels=best.optimum.point.levels)
    again = maximise_restricted(plain.records, start, [True], plain.optimum.prior)
    likelier = again.score.log_likelihood > plain.optimum.score.log_likelihood + LIKELIER
    return replace(plain, optimum=again) if likelier and not _inverted(again) else plain


def _inverted(optimum: Optimum) -> bool:
    """Whether a climb from other levels ended at the inverse of a feedback loop, which the search rejects."""
    return any(is_inverse_loop(optimum, k) for k in range(optimum.point.gain.size))


def averaged(axes: Sequence[Axis], family: Family, name: str) -> Axis:
    """The axis as published where several laws are plausible: the likeliest, with the unions of all their intervals.

    Args:
        axes: The axis under each law of the family, in its order.
        family: The laws.
        name: Name of the axis.
    """
    laws = tuple(weighed_law(law, family.plain, name, axis) for law, axis in zip(family.laws, axes, strict=True))
    return replace(united(axes[0], axes[1:]), laws=laws, lag_prior=_lag_share(family.laws[0].estimate))


def united(first: Axis, others: Sequence[Axis]) -> Axis:
    """An axis with the unions of its intervals and those of the same axis under other laws; statuses follow them."""
    if not others:
        return first
    ci95 = {
        key: hull([ends, *(other.ci95[key] for other in others if key in other.ci95)])
        for key, ends in first.ci95.items()
    }
    extras = [extra for extra in structure_named(first.structure).extras if extra.estimated]
    status = statuses(ci95) | {extra.name: extra_status(extra, ci95[extra.name]) for extra in extras}
    unknown = {key for key, said in status.items() if said != "ok"}
    combinations = {
        key: Combination(
            part.value,
            hull([part.ci95, *(other.combinations[key].ci95 for other in others if key in other.combinations)]),
        )
        for key, part in first.combinations.items()
    }
    known = {key: None if key in unknown else getattr(first, key) for key in COEFFICIENTS}
    return replace(
        first,
        input=known["input"],
        damping=known["damping"],
        delay=known["delay"],
        ci95=ci95,
        stderr={key: None if key in unknown else error for key, error in first.stderr.items()},
        status={
            key: "not_identifiable" if key in unknown and said == "ok" else said for key, said in first.status.items()
        },
        combinations=combinations,
        extra={key: None if key in unknown else value for key, value in first.extra.items()},
    )


def weighed_law(law: Law, plain: Estimate, name: str, axis: Axis) -> Weighed:
    """A law of an axis as in the model file.

    Args:
        law: The law.
        plain: Estimate of the axis under the first-order law with a delay.
        name: Name of the axis.
        axis: The axis under this law.
    """
    optimum, k = law.estimate.optimum, law.estimate.place
    ((names, covariance),) = covariances((name,), [law.estimate], {name: axis}).items()
    return weighed(
        structure_at(optimum, k).name,
        Predictor(
            input=float(optimum.point.gain[k]),
            damping=float(np.exp(optimum.point.log_damping[k])),
            delay=float(optimum.point.delay[k]),
            extra=optimum.point.extra_values(k),
        ),
        [one.partition(".")[2] for one in names],
        covariance,
        law.weight,
        optimum.score.log_likelihood - plain.optimum.score.log_likelihood,
    )


def _lag_share(estimate: Estimate) -> float | None:
    """Share of the information about the logarithm of the lag that is due to its prior; None without such a prior."""
    optimum, k = estimate.optimum, estimate.place
    lag = next((extra.name for extra in estimated_extras(optimum, k) if extra.place == LAG), None)
    if lag is None or optimum.prior is None:
        return None
    at = optimum.point.place(lag, k)
    return float(optimum.covariance[at, at] / LAG_SPREAD**2)
