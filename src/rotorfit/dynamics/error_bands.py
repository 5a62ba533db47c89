"""Error bands of predictions, stated at every start from the past alone, and how often they contained the truth.

A band starts from the variance that the filter itself predicts: the future disturbance, and the uncertainty of trim and
start velocity. What the filter cannot know, such as a slightly wrong law, is learned from the flight: the ratio of the
squared errors of its own earlier predictions over the same horizon to their predicted variances gives a factor. Few of
these errors are independent, so the factor is shrunk towards 1 and the band is one of Student's t.

Source: A. Gelman et al., Bayesian Data Analysis (2013), ch. 2.6, for the scaled inverse chi-squared that draws to 1;
I. Gibbs, E. Candes, NeurIPS 34 (2021), for bands that follow their own past errors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rotorfit.core.error_bands import BandScore, Coverage
from rotorfit.core.frames import AXES, Array
from rotorfit.dynamics.kinematics import REFERENCE_HALF_WIDTH, REFERENCE_LEAST
from rotorfit.dynamics.protocol import LEAST_SCORES, START_EVERY, Predictions, end_errors

NOMINAL = (0.5, 0.95)
"""Shares of the errors that the bands should contain."""

MEMORY = 60.0
"""Time after which the weight of a past error has decayed to 1/e [s]."""

SMOOTH_VALUE, SMOOTH_SLOPE = 9 / 4, 75 / 4
"""Variance of the value, and of the slope times the squared half width, at the middle of a cubic fitted to n points,
times n over the variance of a point: the reference velocity has an error, too."""

DRAWN = 6.0
"""Number of independent errors that the filter's own variance counts as (prior degrees of freedom)."""

MOST_FREEDOM = 12.0
"""Largest number of degrees of freedom: the errors of real flights have heavier tails than a Gaussian."""


@dataclass(frozen=True)
class Bands:
    """Error bands at one horizon for S starts; quantities are position and velocity, axes x, y, z, yaw, heading frame.

    Attributes:
        start: Shape (S,) [s].
        error: Prediction errors, shape (S, 2, 4) [m, rad; m/s, rad/s]; NaN where not measured.
        deviation: Predicted standard error, from the past alone, shape (S, 2, 4); NaN for axes without a prediction.
        freedom: Degrees of freedom of Student's t, shape (S, 2, 4).
    """

    start: Array
    error: Array
    deviation: Array
    freedom: Array

    def half_width(self, nominal: float, of: Any = ...) -> Array:
        """Half width of the bands with this nominal coverage, shape (S, 2, 4), or of the selected elements."""
        from scipy.special import stdtrit

        return np.asarray(stdtrit(self.freedom[of], 0.5 + nominal / 2) * self.deviation[of])


class Stated(NamedTuple):
    """Errors and predicted variances at one horizon for S starts, from which bands are made.

    Attributes:
        start: Shape (S,) [s].
        known: When the poses that an error needs have come, shape (S,) [s].
        error: See `Bands`.
        variance: Variance of the measurement as predicted by the filters, shape (S, 2, 4).
    """

    start: Array
    known: Array
    error: Array
    variance: Array


def stated(part: Predictions, horizon: float) -> Stated:
    """Errors of predictions, and the variances predicted by their filters; the predictions must have states."""
    half = _half_width(part)
    return Stated(
        part.start,
        part.start + horizon + half,
        end_errors(part, part.predicted, horizon),
        _variance(part, horizon, half),
    )


def error_bands(parts: Sequence[Predictions], horizon: float) -> Bands:
    """Error bands of all predictions of a flight at one horizon.

    Args:
        parts: In the order of their starts, with their states.
        horizon: Horizon [s].
    """
    return bands_of([stated(part, horizon) for part in parts], horizon)


def bands_of(pieces: Sequence[Stated], horizon: float) -> Bands:
    """Error bands from pieces in the order of their starts, at one horizon [s]."""
    none = Stated(np.empty(0), np.empty(0), np.empty((0, 2, 4)), np.empty((0, 2, 4)))
    start, known, error, variance = (np.concatenate(column) for column in zip(none, *pieces, strict=True))
    factor, freedom = _learned(start, known, error**2 / variance, horizon)
    return Bands(start, error, np.sqrt(variance * factor), freedom)


def _half_width(part: Predictions) -> float:
    """Half width of the window from whose poses the velocity is measured [s]."""
    return max(REFERENCE_HALF_WIDTH, (REFERENCE_LEAST - 1) / 2 * part.period)


def _variance(part: Predictions, horizon: float, half: float) -> Array:
    """Variance of the measurement as predicted by the filters, in the heading frame at the horizon, (S, 2, 4)."""
    out = np.full((part.start.size, 2, 4), np.nan)
    count = max(REFERENCE_LEAST, 2 * half * part.time.size / (part.time[-1] - part.time[0]))
    for first, state in zip((0, 2), part.states, strict=True):
        if state is not None:
            out[:, :, first : first + 2] = state.variance(horizon)
            for k in range(2):
                if AXES[first + k] in part.alone:
                    out[:, 1, first + k] += SMOOTH_VALUE / count * state.noise[:, k]
                else:
                    out[:, 0, first + k] += state.noise[:, k]
                    out[:, 1, first + k] += SMOOTH_SLOPE / (count * half**2) * state.noise[:, k]
    step = np.searchsorted(part.time, part.start + horizon, side="right") - 1 - part.first
    turned = part.heading[np.arange(part.start.size), np.clip(step, 0, part.heading.shape[1] - 1)]
    along = np.cos(turned - part.pose[part.first - 1, 3])[:, None] ** 2
    x, y = out[..., 0].copy(), out[..., 1].copy()
    out[..., 0], out[..., 1] = along * x + (1 - along) * y, along * y + (1 - along) * x
    return out


def _learned(start: Array, known_from: Array, square: Array, horizon: float) -> tuple[Array, Array]:
    """Variance factor and degrees of freedom at every start, from errors known by then, both (S, 2, 4).

    Args:
        start: Increasing, shape (S,) [s].
        known_from: When the error of each start is known, shape (S,) [s].
        square: Squared errors over their predicted variances, shape (S, 2, 4); NaN where there is none.
        horizon: Horizon [s]; overlapping predictions share their errors.
    """
    factor, freedom = np.ones(square.shape), np.full(square.shape, DRAWN)
    known, seen = np.nan_to_num(square), np.isfinite(square)
    share = min(1.0, START_EVERY / horizon)
    count, total = np.zeros(square.shape[1:]), np.zeros(square.shape[1:])  # both decayed to the previous start
    past = np.searchsorted(known_from, start, side="right")
    for s in range(start.size):
        before = max(s - 1, 0)
        kept = np.exp((start[before] - start[s]) / MEMORY)
        count, total = kept * count, kept * total
        for i in range(past[before] if s else 0, past[s]):
            weight = np.exp((start[i] - start[s]) / MEMORY)
            count, total = count + weight * seen[i], total + weight * known[i]
        n = share * count
        factor[s] = (DRAWN + share * total) / (DRAWN + n)
        freedom[s] = np.minimum(DRAWN + n, MOST_FREEDOM)
    return factor, freedom


def band_scores(pieces: Mapping[float, Sequence[Stated]]) -> dict[str, dict[str, BandScore]]:
    """Coverage of the bands of a flight: axis name to horizon [s] as `%g` to the score.

    Args:
        pieces: Horizon [s] to errors and variances, in the order of the starts.
    """
    found = {f"{horizon:g}": bands_of(each, horizon) for horizon, each in pieces.items()}
    return {axis: {key: _score(bands, k) for key, bands in found.items()} for k, axis in enumerate(AXES)}


def _score(bands: Bands, k: int) -> BandScore:
    velocity = np.isfinite(bands.error[:, 1, k])
    return BandScore(int(velocity.sum()), _coverage(bands, 1, k), _coverage(bands, 0, k))


def _coverage(bands: Bands, what: int, k: int) -> tuple[Coverage, ...]:
    good = np.isfinite(bands.error[:, what, k]) & np.isfinite(bands.deviation[:, what, k])
    if good.sum() < LEAST_SCORES:
        return ()
    error, out = np.abs(bands.error[good, what, k]), []
    for nominal in NOMINAL:
        half = bands.half_width(nominal, (good, what, k))
        out.append(Coverage(nominal, float(np.mean(error <= half)), float(np.mean(half))))
    return tuple(out)
