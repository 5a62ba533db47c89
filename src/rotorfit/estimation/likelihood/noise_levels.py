"""Disturbance levels for prediction, estimated at the coefficients of another estimator."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.laws import LEVELS_OF, start_levels
from rotorfit.core.model import Axis, Predictor
from rotorfit.estimation.likelihood.axis_estimate import free_of
from rotorfit.estimation.likelihood.blocks import Record, measured_by, record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, approached, maximise
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import DAMPING_RANGE
from rotorfit.estimation.likelihood.trims import new_trim_variance, trims_of


def settle_levels(
    flights: Sequence[Flight], points: Mapping[str, Predictor]
) -> list[tuple[tuple[str, ...], list[Record], Optimum]]:
    """Levels, trims and start velocities at given coefficients, by the restricted likelihood.

    x and y of a vehicle that turns are estimated together; if only one of them has coefficients, the other gets a gain
    of 0 and a damping of 1 1/s. A damping outside the range of the likelihood is clipped to it.

    Args:
        flights: Flights that command one of the axes.
        points: Axis to its coefficients: one axis, or x and y.

    Returns:
        Axes, records and optimum, of all axes together or one entry per axis; empty where the flights are too short.
    """
    axes = ("x", "y") if {"x", "y"} & set(points) else tuple(points)
    records = _records(flights, axes)
    if not records:
        return []
    if not all(rec.held for rec in records):
        return [_settled(records, axes, points)]
    alone = {axis: records if axes == (axis,) else _records(flights, (axis,)) for axis in points}
    return [_settled(some, (axis,), points) for axis, some in alone.items()]


def _records(flights: Sequence[Flight], axes: Sequence[str]) -> list[Record]:
    return [rec for flight in flights if (rec := record(flight, axes))]


def _settled(
    records: list[Record], group: tuple[str, ...], points: Mapping[str, Predictor]
) -> tuple[tuple[str, ...], list[Record], Optimum]:
    chosen = [points.get(axis, Predictor(0.0, 1.0, 0.0)) for axis in group]
    start = replace(
        start_point(records, 0.0, 1.0, np.tile(start_levels(measured_by(records)), (len(group), 1))),
        gain=np.array([point.input for point in chosen]),
        log_damping=np.log(np.clip([point.damping for point in chosen], *DAMPING_RANGE)),
        delay=np.array([point.delay for point in chosen]),
    )
    free = free_of(records, [False] * len(group))
    return group, records, maximise(records, approached(records, start, free), free)


def with_levels(flights: Sequence[Flight], axes: Mapping[str, Axis]) -> dict[str, Axis]:
    """The axes of one group with the disturbance levels estimated at their predictors.

    Args:
        flights: Flights that command one of the axes.
        axes: The axes by name; one without a predictor is left as it is.
    """
    out = dict(axes)
    points = {axis: known.predictor for axis, known in axes.items() if known.predictor}
    for group, _, optimum in settle_levels(flights, points) if points else []:
        for k, axis in enumerate(group):
            if axis in points:
                out[axis] = replace(out[axis], noise=noise_of(optimum, k, axis))
    return out


def noise_of(optimum: Optimum, k: int, axis: str) -> dict[str, float]:
    """Disturbance levels by name, not as logarithms, and the variance of a new flight's trim as `trim_variance`.

    Args:
        optimum: The optimum.
        k: Place of the axis in it.
        axis: Name of the axis.
    """
    levels, (trim, variance) = np.exp(optimum.point.levels[k]), trims_of(optimum)
    return {name: float(v) for name, v in zip(LEVELS_OF[optimum.point.measured], levels, strict=True)} | {
        "trim_variance": new_trim_variance(trim[:, k], variance[:, k], axis)
    }
