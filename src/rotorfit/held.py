"""Which flights move an axis, and which only hold it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.flight import Flight, Note
from rotorfit.frames import AXES

HELD = 0.2
"""RMS of the commands of an axis, as a share of those of the flight that moves it most, below which it is held."""


def without_held(flights: Sequence[Flight], beside: Sequence[Flight] = ()) -> list[Flight]:
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
