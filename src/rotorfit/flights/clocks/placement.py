"""Flight -> the same flight with its commands earlier or later, where the clocks do not show when they were sent."""

from dataclasses import replace

import numpy as np

from rotorfit.core.flight_data import Flight, Note, Segment
from rotorfit.dynamics.protocol import START_EVERY


def with_later_commands(flight: Flight, by: float, like: str) -> Flight:
    """Moves the commands of a flight; its poses stay.

    A segment loses what the moved commands no longer cover. Its start moves in whole steps between the starts of
    predictions, so that predictions of the same flight, moved by different times, can be compared start by start.

    Args:
        flight: A flight whose commands were placed by their answer.
        by: By how much the commands are later [s].
        like: Whose answer the flight has afterwards, for the note.
    """
    lost = START_EVERY * float(np.ceil(max(by, 0.0) / START_EVERY))
    segments = tuple(
        Segment(s.start + lost, s.end + min(by, 0.0)) for s in flight.segments if s.start + lost < s.end + min(by, 0.0)
    )
    later = flight.command_time + by
    kept = [np.flatnonzero((later > s.start) & (later < s.end)) for s in segments]
    first = [int(np.searchsorted(later, s.start, side="right")) - 1 for s in segments]
    places = np.concatenate([np.array([], int), *(np.append(a, b) for a, b in zip(first, kept, strict=True))])
    time = later[places]
    time[np.cumsum([0, *(k.size + 1 for k in kept[:-1])])[: len(first)]] = [s.start for s in segments]
    said = f"the commands were moved by a further {by:+.3f} s, so that they are answered as {like}"
    return replace(
        flight,
        command_time=time,
        command=flight.command[places],
        reference=None if flight.reference is None else flight.reference[places],
        segments=segments,
        clocks=flight.clocks and replace(flight.clocks, offset=flight.clocks.offset + by),
        notes=(*flight.notes, Note("clocks_placed", said, time.size)),
    )
