"""The rungs between the paper and the likelihood, as axes of a model."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.estimate import answers_motion
from rotorfit.filtered import svf, weak
from rotorfit.flight import Flight
from rotorfit.frames import Array
from rotorfit.instrument import COMMAND, iv
from rotorfit.model import COEFFICIENTS, Axis
from rotorfit.output_error import oe
from rotorfit.rung import axis_of_rung
from rotorfit.settle import settled, with_levels

RUNGS = {"svf": svf, "weak": weak, "iv": iv, "oe": oe}
"""Method to its estimator."""

NOT_VALID = "not valid here: the commands answer the motion, and no reference was recorded"
"""What is said of an instrument made from commands that a feedback loop gave."""


def axes_by_rung(
    flights: Sequence[Flight], group: Sequence[str], method: str
) -> tuple[dict[str, Axis], dict[tuple[str, ...], Array], dict[str, str]]:
    """Axes that are estimated together, by one of the rungs.

    Args:
        flights: Those that move one of the axes.
        group: x, y or both; z; or yaw.
        method: A key of `RUNGS`.

    Returns:
        Axis to what may be said of it, with the disturbance levels that prediction needs and a trim for each flight;
        the covariance of (input, damping, delay) of the axes with numbers, under its names; and axis to what the rung
        says of its numbers: why there is none, which instrument was used, whether it is valid.
    """
    rung = RUNGS[method](flights, ("x", "y") if set(group) & {"x", "y"} else tuple(group))
    place = {axis: rung.axes.index(axis) for axis in group}
    told = {axis: axis_of_rung(rung, axis) for axis in group}
    axes = with_levels(
        flights, {axis: _with_trim(known, rung.trim[:, place[axis]]) for axis, (known, _) in told.items()}
    )
    remarks = {axis: [part for part in (told[axis][1], rung.remark.get(axis, "")) if part] for axis in group}
    if method == "iv":
        for axis in _answering(flights, {axis: axes[axis] for axis in group if COMMAND in rung.remark.get(axis, "")}):
            remarks[axis].append(NOT_VALID)
    known = [axis for axis in group if axes[axis].predictor]
    K = len(rung.axes)
    index = [offset + place[axis] for axis in known for offset in (0, K, 2 * K)]
    names = tuple(f"{axis}.{name}" for axis in known for name in COEFFICIENTS)
    blocks = {names: rung.covariance[np.ix_(index, index)]} if known else {}
    return axes, blocks, {axis: "; ".join(parts) for axis, parts in remarks.items() if parts}


def _with_trim(axis: Axis, trim: Array) -> Axis:
    return replace(axis, trim=tuple(float(c) if np.isfinite(c) and axis.predictor else None for c in trim))


def _answering(flights: Sequence[Flight], axes: Mapping[str, Axis]) -> list[str]:
    """Those of the axes whose commands follow what the model did not foresee: the mark of a feedback loop."""
    points = {axis: known.predictor for axis, known in axes.items() if known.predictor}
    return [
        axis
        for group, records, optimum in (settled(flights, points) if points else [])
        for k, axis in enumerate(group)
        if axis in points and answers_motion(records, optimum, k)
    ]
