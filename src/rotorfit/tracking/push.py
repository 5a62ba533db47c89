"""How hard was the push? The posterior distribution of the acceleration with which a payload or a weak rotor begins.

An autopilot learns a new weight or torque: its push a exp(-t / T) fades, with a time constant T that nobody tells. With
the push at an instant of `since`, the whitened innovations of z or yaw are

    y = X b + a h(T) + noise

where X has the sensitivities of all rows to what the regime leaves unknown, b, with a flat prior, and h(T) is the
whitened position after such a push. For each instant and T the posterior of a is normal, and the evidence weighs it;
the interval is that of the mixture. So where a second of poses hardly tells T, the interval allows for it.

Was it a push at all? A delay that comes in still air pushes, too, as long as one command acts. The evidence of a push
is compared with that of shifts of the coefficients from the same instants on, as in `instant`. There the push need not
fade exactly so: it has the derivative of h(T) by log T beside it.

Source: the conjugate normal posterior, and its mixture over a grid of nuisance parameters, as in A. Gelman et al.,
Bayesian Data Analysis, 3rd ed. (2013), sections 2.5 and 3.1; odds of two models as in R. E. Kass, A. E. Raftery, J.
Amer. Statist. Assoc. 90 (1995), pp. 773-795.
"""

import numpy as np
from scipy.special import logsumexp

from rotorfit.core.frames import Array
from rotorfit.tracking.instant import (
    instants_of,
    log_posterior,
    mean_square,
    mixture_interval,
    now_of,
    products_of,
    unexplained,
)
from rotorfit.tracking.scores import EXPECTED, Scores

LEARNS = np.geomspace(0.05, 4.0, 20)
"""Time constants with which an autopilot may learn a push [s], all equally likely by their logarithm: from a thrust
estimate that follows the acceleration to the slow pole of a climb loop with an integrator, 1.7 s, and beyond."""

LARGE = 10.0
"""Standard deviation of a push beforehand, in units of `EXPECTED`: half of the weight."""

LATER = (0.0, 0.1, 0.2)
"""By how much answers may come later [s], all equally likely: to first order alone, 0.1 s of delay of a quick axis
looks more like a push."""

SHAPE = 0.2
"""Relative standard deviation of a push because it does not fade exactly as exp(-t / T)."""

BENDS = 0.5
"""Standard deviation of log T within one push: an autopilot with an integrator learns too much before it has learnt."""


def push_interval(scores: Scores, since: tuple[float, float]) -> tuple[float, float]:
    """The 95 % interval of the first acceleration of a push [m/s^2, rad/s^2].

    Args:
        scores: Those of z or of yaw.
        since: The interval of its instant [s].
    """
    now, instants = now_of(scores), instants_of(scores, since)
    product, power = np.transpose([unexplained(now, now.pushed(instant, LEARNS)) for instant in instants], (1, 0, 2))
    noise = 1.0
    for _ in range(2):
        precision = power / noise + LARGE**-2
        mean = product / noise / precision
        log = 0.5 * mean**2 * precision - 0.5 * np.log(precision)
        i, k = np.unravel_index(int(np.argmax(log)), log.shape)
        noise = _mean_square(now, instants[i], mean[i, k] * now.pushed(instants[i], LEARNS[[k]])[0])
    low, high = mixture_interval(log, mean, np.sqrt(1 / precision + (SHAPE * mean) ** 2))
    return EXPECTED["trim"] * low, EXPECTED["trim"] * high


def odds_of_a_push(scores: Scores, since: tuple[float, float]) -> float:
    """Logarithm of the odds of a push against shifts of the coefficients; equal beforehand.

    Both are whitened by the filter of the regime: the strength of the gusts now is judged from innovations that the
    change has made large.

    Args:
        scores: Those of z or of yaw.
        since: The interval of the instant [s].
    """
    instants, known = instants_of(scores, since), scores.rows.shape[1] - 1
    first = [int(at) for at in np.searchsorted(scores.time, instants)]
    answers = np.array([not name.endswith(".trim") for name in scores.names])  # a trim that begins is a push
    shifts = [
        (at, scores.begun(float(scores.time[at]), later)[at:, answers])
        for at in dict.fromkeys(first)
        for later in LATER
    ]
    of_shifts = np.array([products_of(scores, at, shapes) for at, shapes in shifts])
    of_pushes = np.array(
        [
            products_of(scores, at, push)
            for instant, at in zip(instants, first, strict=True)
            for push in _columns(scores, instant, at)
        ]
    )
    log, solution = log_posterior(of_shifts, known)
    best = int(np.argmax(log))
    at, shapes = shifts[best]
    shifted = mean_square(scores, at, shapes, solution[best])
    log, solution = log_posterior(of_pushes, known)
    best = int(np.argmax(log))
    i, k = divmod(best, LEARNS.size)
    pushed = mean_square(scores, first[i], _columns(scores, instants[i], first[i])[k], solution[best])
    noise = min(shifted, pushed)
    return _mean_evidence(of_pushes / noise, known) - _mean_evidence(of_shifts / noise, known)


def _columns(scores: Scores, instant: float, at: int) -> Array:
    """A push of `LARGE` from a row on, and its derivative by log T, for each of `LEARNS`, shape (T, N - at, 2)."""
    shapes = LARGE * scores.pushed(instant, LEARNS)[:, at:]
    return np.stack([shapes, BENDS * np.gradient(shapes, np.log(LEARNS), axis=0)], axis=-1)


def _mean_evidence(products: Array, known: int) -> float:
    """Logarithm of the mean evidence of some changes; arguments as for `log_posterior`."""
    log, _ = log_posterior(products, known)
    return float(logsumexp(log)) - float(np.log(log.size))


def _mean_square(scores: Scores, begun: float, push: Array) -> float:
    """Mean square of the innovations from an instant on, less a push then; at least 1, and that before the instant."""
    parts = np.split(scores.innovation - push, [int(np.searchsorted(scores.time, begun))])
    return max(1.0, *(float(np.mean(part**2)) for part in parts if part.size > 1))
