"""Validity: the speeds at which a model was trained, and its prediction errors, as lines of text."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotorfit.assessment.validation import to_mapping
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, POSE_UNITS, Array, heading_from_world
from rotorfit.core.model import Model
from rotorfit.core.results import Validation
from rotorfit.dynamics.kinematics import seen_in

RARE = 99.0
"""Percentile of the samples that is reported as the largest [%]."""

HORIZONS = ("0.5", "1", "2", "5")


def trained_on(flights: Sequence[Flight]) -> dict[str, str]:
    """Axis name to a sentence about the speeds and commands of the flights that moved it.

    Args:
        flights: The available training flights; axes that none of them moved are left out.
    """
    speeds: dict[str, list[Array]] = {axis: [] for axis in AXES}
    commands: dict[str, list[Array]] = {axis: [] for axis in AXES}
    for flight in flights:
        seen = seen_in(flight, *flight.span)
        velocity = np.column_stack([heading_from_world(seen.reference[:, :2], seen.pose[:, 3]), seen.reference[:, 2:]])
        for k, axis in enumerate(AXES):
            if axis in flight.axes:
                speeds[axis].append(np.abs(velocity[np.isfinite(velocity[:, k]), k]))
                commands[axis].append(np.abs(flight.command[:, k]))
    return {
        axis: f"speeds up to {_largest(speeds[axis])} {'rad/s' if axis == 'yaw' else 'm/s'}, "
        f"commands up to {_largest(commands[axis])} (99 % of the samples)"
        for axis in AXES
        if sum(part.size for part in speeds[axis])
    }


def _largest(parts: Sequence[Array]) -> str:
    return f"{np.percentile(np.concatenate(parts), RARE):.3g}"


def scores(model: Model, validation: Validation | None, axes: Sequence[str] = AXES) -> list[str]:
    """A line of prediction errors for each axis and flight: from the validation, else from the model's `leave_one_out`.

    Args:
        model: The model.
        validation: Scores on other flights; None if there is no validation.
        axes: The exported axes.
    """
    if validation:
        mapping: Mapping[str, Any] = to_mapping(validation)
    elif model.leave_one_out:
        mapping = model.leave_one_out
    else:
        return ["Not known: the model file has none; rotorfit export MODEL LOG... scores the model on these logs."]
    lines = [
        line
        for flight in mapping["flights"]
        for axis in axes
        if axis in flight["moved"] and (line := _line(axis, flight))
    ]
    return lines or ["None: no flight was long enough to be predicted."]


def _line(axis: str, flight: Mapping[str, Any]) -> str:
    horizons = flight["axes"][axis]["horizons"]
    unit = POSE_UNITS[axis]
    known = [
        f"{horizon} s {at['velocity_rmse']:.3g} {unit}/s and {at['position_rmse']:.3g} {unit}"
        for horizon in HORIZONS
        if (at := horizons.get(horizon)) and at["velocity_rmse"] is not None and at["position_rmse"] is not None
    ]
    seen = "; the model was fitted to part of it, which proves nothing" if flight["fitted"] else ""
    return f"{axis} on {flight['path']}: {', '.join(known)}{seen}" if known else ""
