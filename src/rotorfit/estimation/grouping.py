"""Which flights move an axis, and which only hold it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import AXES
from rotorfit.estimation.likelihood.blocks import record

HELD = 0.2
"""RMS of the commands of an axis, as a share of those of the flight that moves it most, below which it is held."""


def without_held_axes(flights: Sequence[Flight], beside: Sequence[Flight] = ()) -> list[Flight]:
    """The flights, each without the axes that it merely holds where another one excites them; with a note.

    What a controller sends to hold an axis answers the axis' own disturbance. In the likelihood of an exact model it
    does no harm and tells next to nothing; where the model is a little wrong it tells the wrong thing with confidence.

    Args:
        flights: To be told apart.
        beside: Further flights of the vehicle that only show how strongly an axis is commanded when it is moved.
    """
    power = [
        [np.mean(f.command[:, k] ** 2) * (axis in f.axes) for k, axis in enumerate(AXES)] for f in (*flights, *beside)
    ]
    strength = np.sqrt(np.reshape(power, (-1, len(AXES))))
    share = strength / np.maximum(strength.max(axis=0, initial=0.0), np.finfo(float).tiny)
    return [
        replace(
            flight,
            axes=tuple(axis for axis in flight.axes if not 0 < row[AXES.index(axis)] < HELD),
            notes=(
                *flight.notes,
                *(
                    Note("held_axis", f"{axis} is only held, by {100 * part:.1f} % of the commands of another flight: "
                         "it is not fitted to this one", len(flight.command))
                    for axis, part in zip(AXES, row, strict=True)
                    if 0 < part < HELD
                ),
            ),
        )
        for flight, row in zip(flights, share[: len(flights)], strict=True)
    ]  # fmt: skip


def commands_axis(flight: Flight, axis: str) -> bool:
    """Whether the flight commands the axis, and does not merely hold it."""
    return axis in flight.axes and bool(np.any(flight.command[:, AXES.index(axis)]))


def groups_of(flights: Sequence[Flight], wanted: Sequence[str]) -> list[tuple[str, ...]]:
    """Axes that are fitted together: x and y through the heading, z, yaw; only those that some flight moves.

    x alone (or y alone) is fitted by itself where every flight that moves it keeps its heading.
    """
    moving = [axis for axis in wanted if any(commands_axis(flight, axis) for flight in flights)]
    plane = tuple(axis for axis in moving if axis in ("x", "y"))
    groups: list[tuple[str, ...]] = [(axis,) for axis in moving if axis in ("z", "yaw")]
    if len(plane) == 1:
        records = [record(flight, plane) for flight in flights if commands_axis(flight, plane[0])]
        plane = plane if all(rec.held for rec in records if rec) else ("x", "y")
    return [plane, *groups] if plane else groups


def serving_flights(flights: Sequence[Flight], group: Sequence[str]) -> list[Flight]:
    """The flights that move one of these axes and are long enough to be scored."""
    return [f for f in flights if any(commands_axis(f, axis) for axis in group) and record(f, group)]
