"""Validity: the speeds at which a model was trained, and its prediction errors, as lines of text."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, POSE_UNITS, Array, heading_from_world
from rotorfit.dynamics.kinematics import seen_in
from rotorfit.exports.subject import Subject, size_of

RARE = 99.0
"""Percentile of the samples that is reported as the largest [%]."""

HORIZONS = ("0.5", "1", "2", "5")

UNKNOWN = "Not known: the model file has none; rotorfit export MODEL LOG... scores the export on these logs."


def trained_on(flights: Sequence[Flight]) -> dict[str, tuple[float, float]]:
    """Axis name to the largest speed [m/s or rad/s] and the largest command of the flights that moved it.

    A vehicle that hovers most of the time says nothing of its commands: those of 0 are not counted.

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
                speeds[axis].append(velocity[np.isfinite(velocity[:, k]), k])
                commands[axis].append(flight.command[flight.command[:, k] != 0, k])
    return {
        axis: (_largest(speeds[axis]), _largest(commands[axis]))
        for axis in AXES
        if sum(part.size for part in speeds[axis]) and sum(part.size for part in commands[axis])
    }


def _largest(parts: Sequence[Array]) -> float:
    return float(np.percentile(np.abs(np.concatenate(parts)), RARE))


def training_of(subject: Subject, axis: str, trained: Mapping[str, Sequence[float]]) -> str:
    """A sentence about the speeds and commands of the training flights, in the export's commands."""
    if subject.original.conversion:
        return "speeds not known: the model was converted to other limits than those of its flights"
    if axis not in trained:
        return "speeds not known: its logs are not at hand"
    speed, command = trained[axis]
    unit = subject.commands[AXES.index(axis)].unit
    unit = {"fraction": "of the limit", "unit of command": ""}.get(unit, unit)
    return (
        f"speeds up to {speed:.3g} {POSE_UNITS[axis]}/s (99 % of the samples), "
        f"commands up to {f'{command * size_of(subject, axis):.3g} {unit}'.strip()} (99 % of those that are not 0)"
    )


def scores(known: Mapping[str, Any] | None, axes: Sequence[str], changed: Sequence[str] = ()) -> list[str]:
    """A line of prediction errors for each axis and flight.

    Args:
        known: Scores as `assessment.validation.to_mapping` has them; None if there are none.
        axes: The exported axes.
        changed: Those whose exported numbers are not the ones that were scored.
    """
    if not known:
        return [UNKNOWN]
    doubts = [one for one in known.get("findings", ()) if one["code"] == "converted" and one["axis"] in axes]
    lines = [
        line
        for flight in known["flights"]
        for axis in axes
        if axis in flight["moved"] and axis not in changed and (line := _line(axis, flight))
    ]
    lines += [
        f"{axis}: not known: the model was scored with another delay; rotorfit export MODEL LOG... scores this one."
        for axis in changed
        if any(axis in flight["moved"] for flight in known["flights"])
    ]
    told = [f"{one['axis']}: {one['evidence']}: {one['effect']}." for one in doubts] if lines else []
    return [*told, *lines] or ["None: no flight was long enough to be predicted."]


def _line(axis: str, flight: Mapping[str, Any]) -> str:
    horizons, unit = flight["axes"][axis]["horizons"], POSE_UNITS[axis]
    known = [
        f"{horizon} s {' and '.join(errors)}"
        for horizon in HORIZONS
        if (errors := _errors(horizons.get(horizon, {}), unit))
    ]
    seen = "; the model was fitted to part of it, which proves nothing" if flight["fitted"] else ""
    return f"{axis} on {flight['path']}: {', '.join(known)}{seen}" if known else ""


def _errors(at: Mapping[str, Any], unit: str) -> list[str]:
    """Of the velocity, and of the position where it is measured."""
    known = ((at.get("velocity_rmse"), f"{unit}/s"), (at.get("position_rmse"), unit))
    return [f"{value:.3g} {per}" for value, per in known if value is not None]
