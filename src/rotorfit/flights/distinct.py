"""Are inputs distinct flights? The same poses twice would count as twice the evidence, or as a proof."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array

RUN = 20
"""Length of a run of poses, with all their digits, that two flights do not share by chance."""

CHANGES = 10
"""Number of changes that a run must contain: two vehicles that stand still look alike."""

LANDMARKS = 24
"""Number of poses by which a flight is recognised in another file."""

NEAR = 6e-4
"""Largest difference in each coordinate of a pose that was saved again with three decimals [m, rad]."""

AT_ONCE = 0.02
"""Largest difference of the time between two landmarks [s]."""

FEWEST, ALONG = 12, 2
"""Least number of landmarks, and of coordinates in which they differ: two turns of one plan, in degrees, are alike."""

SHARED = 0.75
"""Least share of the landmarks that a flight must pass, in their order of time, to be the same: in coarse steps two
hovers pass many at other times."""

LEAST = 1.0
"""Shared time from which two flights are refused [s]: parts of one log may touch."""


def check_flights(flights: object) -> None:
    """Refuses anything but a sequence of flights, such as one flight or the path of a log.

    Raises:
        TypeError: Names the type that was given.
    """
    if not isinstance(flights, Sequence) or isinstance(flights, str | bytes):
        raise TypeError(f"expected a sequence of flights, got {type(flights).__name__}")
    for one in flights:
        if not isinstance(one, Flight):
            raise TypeError(f"expected a sequence of flights, got one of {type(one).__name__}")


def check_distinct(flights: Sequence[Flight]) -> None:
    """Refuses flights that share a stretch of their poses, whatever the names of their files.

    Args:
        flights: Read with one card.

    Raises:
        FlightError: Two of them are the same, or overlap.
    """
    if len(flights) < 2:
        return
    seen: dict[int, int] = {}
    for number, flight in enumerate(flights):
        rows = np.ascontiguousarray(_poses(flight))
        if len(rows) <= RUN:
            continue
        moving = np.any(np.diff(rows, axis=0) != 0, axis=1)
        changes = np.concatenate([[0], np.cumsum(moving)])
        keys = [
            hash(rows[i : i + RUN].tobytes()) if changes[i + RUN - 1] - changes[i] >= CHANGES - 1 else None
            for i in range(len(rows) - RUN + 1)
        ]
        steps = np.diff(flight.pose_time)
        shared: dict[int, float] = {}
        for i, key in enumerate(keys):
            if key is not None and key in seen:
                shared[seen[key]] = shared.get(seen[key], 0.0) + float(steps[i])
        for other, time in shared.items():
            if time >= LEAST:
                raise FlightError(_refusal(flights[other], flight, time))
        seen |= {key: number for key in keys if key is not None}


def landmarks(flight: Flight) -> tuple[tuple[float, ...], ...]:
    """Some poses of a flight, evenly over those that differ from the one before: time [s], x, y, z, yaw [m, rad]."""
    rows = _poses(flight)
    moving = np.flatnonzero(np.any(np.diff(rows, axis=0) != 0, axis=1) & np.all(np.isfinite(rows[1:]), axis=1)) + 1
    some = moving[np.linspace(0, moving.size - 1, min(LANDMARKS, moving.size)).astype(int)]
    return tuple(map(tuple, np.round(np.column_stack([flight.pose_time[some], rows[some]]), 6).tolist()))


def passes(flight: Flight, marks: Sequence[Sequence[float]]) -> bool:
    """Whether a flight passes most of the landmarks of another at the same intervals: then it is the same."""
    if len(marks) < FEWEST or np.sum(np.ptp(np.array(marks)[:, 1:], axis=0) > NEAR) < ALONG:
        return False
    rows, offsets = _poses(flight), Counter[int]()
    for time, *pose in marks:
        met = flight.pose_time[np.all(np.abs(rows - pose) < NEAR, axis=1)] - time
        slots = np.round(met / AT_ONCE).astype(int)
        offsets.update({*slots.tolist(), *(slots + 1).tolist()})  # two slots each, so that none is missed by rounding
    return max(offsets.values(), default=0) > SHARED * len(marks)


def _poses(flight: Flight) -> Array:
    """Position and heading, shape (N, 4)."""
    return np.column_stack([flight.position, flight.yaw])


def _refusal(one: Flight, other: Flight, time: float) -> str:
    if one.sha256 == other.sha256 and one.path == other.path:
        spans = " and ".join(f"{part.span[0]:.2f}:{part.span[1]:.2f}" for part in (one, other))
        return (
            f"{one.path}: its parts {spans} overlap: what is in both would count twice; give parts that do not overlap"
        )
    return f"{one.path} and {other.path} hold {time:.1f} s of the same poses, which would count twice; give each once"
