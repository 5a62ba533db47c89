"""Coefficients beside the accuracy that a controller needs."""

from collections.abc import Mapping

import numpy as np

from rotorfit.core.laws import given_by_law
from rotorfit.core.model import COEFFICIENTS, NORMAL, Axis
from rotorfit.planning.next_flight import WANTED


def beside_target(axis: Axis) -> Mapping[str, float]:
    """Estimated coefficient to its standard error for the vehicle over the target; infinite where it is not known.

    An interval that other laws widen counts by its width.
    """
    if axis.predictor is None:
        return {}
    given = given_by_law(axis.structure)
    return {name: _beside_target(axis, name) for name in COEFFICIENTS if name not in given}


def _beside_target(axis: Axis, name: str) -> float:
    value, error, (low, high) = getattr(axis, name), axis.stderr[name], axis.ci95[name]
    if low is not None and high is not None:
        error = max(error or 0.0, (high - low) / (2 * NORMAL))
    if axis.status[name] != "ok" or value is None or error is None:
        return np.inf
    target = WANTED[COEFFICIENTS.index(name)]
    return float(error / (target if name == "delay" else target * abs(value)))
