"""Results of the regressions in `METHODS`, as axes of a model."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pkgutil import resolve_name

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.core.model import COEFFICIENTS, Axis
from rotorfit.estimation.likelihood.noise_levels import with_levels
from rotorfit.estimation.methods import METHODS
from rotorfit.estimation.regression.result import MethodResult, axis_of_rung

Estimator = Callable[[Sequence[Flight], tuple[str, ...]], MethodResult]
"""From flights of one vehicle and setting, and the axes that are estimated together, to their coefficients."""


def estimator_of(method: str) -> Estimator:
    """The function behind a key of `METHODS` with an estimator."""
    estimator: Estimator = resolve_name(METHODS[method].estimator)
    return estimator


def axes_by_method(
    flights: Sequence[Flight], group: Sequence[str], method: str
) -> tuple[dict[str, Axis], dict[tuple[str, ...], Array], dict[str, str]]:
    """Estimates the axes of one group by one of the regressions.

    Args:
        flights: Flights that command one of the axes.
        group: x, y or both; z; or yaw.
        method: A key of `METHODS` with an estimator.

    Returns:
        The axes by name, with the disturbance levels for prediction and a trim for each flight; the covariance of
        (input, damping, delay) of the axes with numbers, keyed by the names of its rows, empty if no axis has numbers;
        and remarks by axis: why there is no number, which instrument was used.
    """
    rung = estimator_of(method)(flights, ("x", "y") if set(group) & {"x", "y"} else tuple(group))
    place = {axis: rung.axes.index(axis) for axis in group}
    told = {axis: axis_of_rung(rung, axis) for axis in group}
    axes = with_levels(
        flights, {axis: _with_trim(known, rung.trim[:, place[axis]]) for axis, (known, _) in told.items()}
    )
    remarks = {axis: "; ".join(filter(None, (told[axis][1], rung.remark.get(axis, "")))) for axis in group}
    known = [axis for axis in group if axes[axis].predictor]
    K = len(rung.axes)
    index = [offset + place[axis] for axis in known for offset in (0, K, 2 * K)]
    names = tuple(f"{axis}.{name}" for axis in known for name in COEFFICIENTS)
    blocks = {names: rung.covariance[np.ix_(index, index)]} if known else {}
    return axes, blocks, {axis: remark for axis, remark in remarks.items() if remark}


def _with_trim(axis: Axis, trim: Array) -> Axis:
    return replace(axis, trim=tuple(float(c) if np.isfinite(c) and axis.predictor else None for c in trim))
