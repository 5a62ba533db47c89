"""What a frozen pose does to a model: the axes that suffer, and the status of what is not known for that reason."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.model import FROZEN, Model

SUFFERING: Mapping[str, tuple[str, ...]] = {"x": ("x", "y"), "y": ("y", "x"), "z": ("z",), "yaw": ("yaw", "x", "y")}
"""Coordinate of the pose to the axes that it serves, its own first: the heading turns x and y into each other."""


def frozen_axes(findings: Iterable[Finding]) -> tuple[str, ...]:
    """The axes whose coefficients suffer from a frozen pose."""
    still = {axis for one in findings if one.code == FROZEN and one.axis for axis in SUFFERING[one.axis]}
    return tuple(axis for axis in AXES if axis in still)


def with_frozen(model: Model, axes: Sequence[str] = AXES) -> Model:
    """A copy in which what a frozen pose keeps from being known has the status `pose_frozen`.

    Args:
        model: The model with its findings.
        axes: The axes that were fitted.
    """
    served = {axis for flight in model.flights for axis in flight.axes if axis in axes}
    still = {axis: model.axes[axis] for axis in frozen_axes(model.findings) if axis in served}
    told = {
        axis: replace(one, status={name: status if status == "ok" else FROZEN for name, status in one.status.items()})
        for axis, one in still.items()
    }
    return replace(model, axes={**model.axes, **told})
