"""Is one model's prediction error really smaller than another's on the same starts?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.forecast import EDGE, LEAST_SCORES, LONGEST_GAP, START_EVERY, Predictions
from rotorfit.frames import Array, heading_from_world

CORRELATED = 2.0
"""Time over which errors of neighbouring starts are taken to go together beside the overlap of the horizon [s]."""

RAN_AWAY = 1e3
"""An error that no vehicle can have [m, m/s; rad]: an unstable model, which no average of squares describes."""


@dataclass(frozen=True)
class Paired:
    """Difference of mean squared errors, first model less second.

    Attributes:
        difference: [m^2/s^2 or m^2; rad]; None where there are too few starts or a prediction ran away.
        stderr: Its standard error; None where the flights are too short for one.
        freedom: Degrees of freedom of the standard error.
        p: Two-sided, by Student's t; None likewise.
        verdict: `better`, `tie` or `worse` for the first model, at 5 %; `short` where there is no standard error;
            `better` without a standard error where the second ran away.
        n: Starts.
    """

    difference: float | None
    stderr: float | None
    freedom: int
    p: float | None
    verdict: str
    n: int


def errors_by_start(parts: Sequence[Predictions], predicted: Sequence[Array], horizon: float) -> tuple[Array, Array]:
    """Per start: mean squared velocity error up to the horizon and squared position error at its end, (S, 4) each.

    The starts that count and the frame are those of `forecast`: x and y in the measured heading.
    """
    velocity: list[Array] = []
    position: list[Array] = []
    for part, values in zip(parts, predicted, strict=True):
        period = float(np.median(np.diff(part.time)))
        gaps = np.concatenate([[0], np.cumsum(np.diff(part.time) > LONGEST_GAP)])
        ends = np.searchsorted(part.time, part.start + horizon + EDGE)
        for s, (first, last, end) in enumerate(zip(part.first, part.last, ends, strict=True)):
            late = part.time[end - 1] <= part.start[s] + horizon - 3 * period
            known = np.isfinite(part.reference[first:end]).all(axis=1)
            if not first < end <= last or late or gaps[end - 1] != gaps[first - 1] or not known.any():
                continue
            error = values[s, : end - first, 1] - part.reference[first:end]
            error[:, :2] = heading_from_world(error[:, :2], part.pose[first:end, 3])
            miss = (values[s, end - first - 1, 0] - part.pose[end - 1])[None]
            miss[:, :2] = heading_from_world(miss[:, :2], part.pose[end - 1 : end, 3])
            velocity.append(np.mean(error[known] ** 2, axis=0))
            position.append(miss[0] ** 2)
    return np.reshape(velocity, (-1, 4)), np.reshape(position, (-1, 4))


def compared(first: Sequence[Array], second: Sequence[Array], horizon: float) -> Paired:
    """Compares squared errors, one array each flight, in the order of the starts.

    The long-run variance of the differences is the mean square of their lowest cosine transforms: those whose period is
    at least four times the longer of the horizon and 2 s, so that the overlap of the predictions is seen as what it is.
    As many cosines, so many degrees of freedom.

    Source: Lazarus, Lewis, Stock, Watson, HAR inference: recommendations for practice, J. Bus. Econ. Stat. 36 (2018).
    """
    from scipy.stats import t as student

    differences = [a - b for a, b in zip(first, second, strict=True)]
    n = sum(d.size for d in differences)
    if n < LEAST_SCORES:
        return Paired(None, None, 0, None, "short", n)
    if any(np.isnan(b).any() for b in second):
        return Paired(None, None, 0, None, "short", n)  # the second has no model of this axis
    if max(float(b.max()) for b in second if b.size) > RAN_AWAY**2:
        return Paired(None, None, 0, None, "better", n)
    mean = sum(float(d.sum()) for d in differences) / n
    variance, freedom = 0.0, 0
    block = max(horizon, CORRELATED) / START_EVERY
    for d in differences:
        count = int(d.size / (2 * block))
        if not count:
            continue
        k, i = np.arange(1, count + 1), np.arange(d.size)
        cosines = np.sqrt(2 / d.size) * np.cos(np.pi * k[:, None] * (i + 0.5) / d.size) @ (d - mean)
        variance += d.size * float(np.mean(cosines**2))
        freedom += count
    if freedom < 2 or variance == 0:
        return Paired(mean, None, freedom, None, "short", n)
    stderr = float(np.sqrt(variance)) / n
    p = float(2 * student.sf(abs(mean) / stderr, freedom))
    verdict = "tie" if p > 0.05 else "better" if mean < 0 else "worse"
    return Paired(mean, stderr, freedom, p, verdict, n)
