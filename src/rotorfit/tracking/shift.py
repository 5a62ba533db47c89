"""By how much did they shift? The posterior distribution of one shift that several coefficients share.

A radio delays all axes alike, a limit scales the gains of some. With the change at an instant t of `since`, the
whitened innovations of each likelihood are

    y = X b + a Z_t + noise

where X has the sensitivities of all rows to what the regime leaves unknown, b, with a flat prior, and Z_t the sum of
those to shifts that begin at t, from the motion as it is then. The shift a is normal beforehand, with a wide standard
deviation, and so it is afterwards for each instant, from all likelihoods together; the evidence weighs the instants,
and the interval is that of the mixture. A window from one instant, as if the vehicle had always been the new one, finds
10 % less of a delay after 2 s.

Source: as for `push`.
"""

from collections.abc import Iterable

import numpy as np

from rotorfit.tracking.changes import variance_along
from rotorfit.tracking.instant import instants_of, mixture_interval, now_of, unexplained
from rotorfit.tracking.scores import Scores

WIDE = 3.0
"""Standard deviation of a shift before it is looked for, in units of `scores.EXPECTED`. Without it the evidence of an
instant would grow without bound the less its rows tell of a shift, such as the last ones of `since`."""

CURVED = 0.1
"""Error of the first-order shift over the square of the shift, both in units of `scores.EXPECTED`."""


def shift_interval(
    scored: Iterable[Scores], names: Iterable[str], since: tuple[float, float], window: float
) -> tuple[float, float] | None:
    """The 95 % interval of a shift that coefficients share, in units of `scores.EXPECTED`; None if nothing shows it.

    Args:
        scored: Scores of each likelihood.
        names: `AXIS.QUANTITY` of the coefficients.
        since: The interval of the instant [s].
        window: Start of the window from which the variance of the scores is known [s].
    """
    there = [(scores, np.isin(scores.names, list(names)).astype(float)) for scores in scored]
    known = [(scores, way, variance) for scores, way in there if (variance := variance_along(scores, window, way))]
    if not known:
        return None
    instants = instants_of(known[0][0], since)
    product, precision = np.zeros(instants.size), np.full(instants.size, WIDE**-2)
    for scores, way, variance in known:
        now = now_of(scores)
        along, power = unexplained(now, np.array([now.begun(instant, 0.0) @ way for instant in instants]))
        product += along / variance
        precision += power / variance
    mean = product / precision
    log = 0.5 * mean**2 * precision - 0.5 * np.log(precision)
    return mixture_interval(log, mean, np.sqrt(1 / precision + (CURVED * mean**2) ** 2))
