"""Why a vehicle seems to answer before its command: clocks that disagree, or commands that were logged too seldom."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rotorfit.flight import Flight

ONE_CLOCK = (".ulg", ".bin")
"""Logs of autopilots: one clock stamps all that is in them."""


def too_early(flights: Sequence[Flight], early: float) -> tuple[str, str]:
    """Effect and remedy of a negative delay, by what the flights allow.

    A command is logged at its row's time. One that was sent between two rows acts before it is logged, by up to a
    period of the rows and half of that in the mean, where commands change all the time.

    Args:
        flights: That serve the axis.
        early: By how much the answer comes before its command [s].
    """
    period = max(float(np.median(np.diff(flight.command_time))) for flight in flights)
    seldom = (
        f"the commands are logged every {1e3 * period:.0f} ms, and one that was sent between two rows acts before it "
        f"is logged: delays come out up to {1e3 * period:.0f} ms too short, {5e2 * period:.0f} ms in the mean"
    )
    if not all(_one_clock(flight) for flight in flights):
        beside = f"; or {seldom}" if early <= period else ""
        return (
            f"the clocks of commands and poses disagree by at least as much{beside}; the delay is not the vehicle's",
            "use one clock for both streams, or the stamps at which both were received"
            + (", and log every command that is sent" if beside else ""),
        )
    one = "one clock stamps commands and poses, so it is not the clocks"
    if early <= period:
        return (
            f"{one}; {seldom}; the delay is not the vehicle's",
            "log every command that is sent (PX4: raise the rate of the set-point's topic in the logger)",
        )
    return (
        f"{one}, nor that commands are logged every {1e3 * period:.0f} ms only; the delay is not the vehicle's",
        "check that the card's command is what the vehicle was told, and not what was measured or filtered of it",
    )


def _one_clock(flight: Flight) -> bool:
    """Whether commands and poses of a flight are stamped by one clock for sure."""
    card = flight.card
    same = card.command_time.source == card.pose_time.source
    return flight.clocks is None and (same or Path(flight.path).suffix.lower() in ONE_CLOCK)
