"""Which flights excite an axis and which only hold it, and which axes are fitted together."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import AXES
from rotorfit.estimation.likelihood.blocks import record

HELD = 0.2
"""An axis is held where the RMS of its commands is below this share of that in the flight that commands it most."""


def without_held_axes(flights: Sequence[Flight], beside: Sequence[Flight] = ()) -> list[Flight]:
    """The flights, each without the axes that it only holds while another flight excites them; with a note.

    The commands by which a controller holds an axis respond to the disturbance of that axis. Under an exact model they
    do no harm and carry next to no information; under a slightly wrong model they bias the estimate with confidence.

    Args:
        flights: Flights of one vehicle.
        beside: Further flights of the vehicle, used only to see how strongly an axis is commanded when it is excited.
    """
    shares = small_commands(flights, beside)
    return [
        without(flight, share, "is not fitted to this flight") for flight, share in zip(flights, shares, strict=True)
    ]


def small_commands(flights: Sequence[Flight], beside: Sequence[Flight] = ()) -> list[dict[str, float]]:
    """The axes that each flight commands by less than `HELD` of another one, with that share.

    Args:
        flights: Flights of one vehicle.
        beside: As for `without_held_axes`.
    """
    power = [
        [np.mean(f.command[:, k] ** 2) * (axis in f.axes) for k, axis in enumerate(AXES)] for f in (*flights, *beside)
    ]
    strength = np.sqrt(np.reshape(power, (-1, len(AXES))))
    shares = strength / np.maximum(strength.max(axis=0, initial=0.0), np.finfo(float).tiny)
    return [
        {axis: float(share) for axis, share in zip(AXES, row, strict=True) if 0 < share < HELD}
        for row in shares[: len(flights)]
    ]


def without(flight: Flight, shares: Mapping[str, float], effect: str) -> Flight:
    """A flight without axes that it only holds, with a note for each.

    Args:
        flight: The flight.
        shares: Those axes, with the share of their commands in those of another flight.
        effect: What becomes of the axis, for the note.
    """
    notes = [
        Note("held_axis", f"{axis} is only held (its commands are {100 * share:.1f} % of those of another flight) and "
             f"{effect}", len(flight.command))
        for axis, share in shares.items()
    ]  # fmt: skip
    return replace(
        flight,
        axes=tuple(axis for axis in flight.axes if axis not in shares),
        held=(*flight.held, *shares),
        notes=(*flight.notes, *notes),
    )


def commands_axis(flight: Flight, axis: str) -> bool:
    """Whether the flight has a non-zero command of the axis, and the axis was not removed as held."""
    return axis in flight.axes and bool(np.any(flight.command[:, AXES.index(axis)]))


def groups_of(flights: Sequence[Flight], wanted: Sequence[str]) -> list[tuple[str, ...]]:
    """Groups of axes that are fitted together: x with y, z, yaw; only axes that some flight commands.

    x and y are coupled through the heading. If only one of them is commanded, it is fitted by itself where every flight
    that commands it holds its heading; otherwise the group is `("x", "y")`, whether the other one is wanted or not.
    """
    moving = [axis for axis in wanted if any(commands_axis(flight, axis) for flight in flights)]
    plane = tuple(axis for axis in moving if axis in ("x", "y"))
    groups: list[tuple[str, ...]] = [(axis,) for axis in moving if axis in ("z", "yaw")]
    if len(plane) == 1:
        records = [record(flight, plane) for flight in flights if commands_axis(flight, plane[0])]
        plane = plane if all(rec.held for rec in records if rec) else ("x", "y")
    return [plane, *groups] if plane else groups


def serving_flights(flights: Sequence[Flight], group: Sequence[str]) -> list[Flight]:
    """The flights that command one of these axes and are long enough to enter the likelihood."""
    return [f for f in flights if any(commands_axis(f, axis) for axis in group) and record(f, group)]
