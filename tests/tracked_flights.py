"""Tracked flights that several tests look at: each is flown and tracked once."""

import functools
import importlib
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flights import flown, steps
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.core.tracked import Alarm, Track
from rotorfit.files.cards import card_from_mapping
from rotorfit.simulation.paper_vehicle import Truth
from rotorfit.tracking.change_watch import GLANCE, REVISED
from rotorfit.tracking.following import Following
from rotorfit.tracking.replayed import growing, tracked

LAW = "first_order_delay"
"""The law that the paper's vehicle obeys, and what short flights can tell."""

TRUTH = Truth(trim=(0.06, -0.04, 0.03, 0.02))
LENGTH = 30.0

QUIET_FROM = 14.0
"""From then on the commands of `rested` stay at zero [s]."""


@functools.cache
def known_flight() -> Flight:
    """A vehicle that stays as it is."""
    return flown(TRUTH, steps(seed=5), LENGTH, seed=5)


@functools.cache
def known() -> tuple[Flight, Track]:
    """The same flight with its track."""
    return known_flight(), tracked(known_flight(), LAW)


@functools.cache
def rested() -> tuple[Flight, Track]:
    """The same, but nothing is commanded from `QUIET_FROM` on."""
    moving = steps(seed=5)

    def command(t: Array) -> Array:
        return np.where((t < QUIET_FROM)[:, None], moving(t), 0.0)

    flight = flown(TRUTH, command, 32.0, seed=5)
    return flight, tracked(flight, LAW)


def tilted(flight: Flight) -> Flight:
    """The flight of a vehicle whose commands are tilts."""
    card = flight.card.raw
    command = {**card["command"], **{axis: {"from": axis, "meaning": "tilt"} for axis in ("x", "y")}}
    return replace(flight, card=card_from_mapping({**card, "command": command, "limits": {"tilt": 0.3}}, "tilts"))


def changing() -> Any:
    """The bench's module of flights in which something changes."""
    bench = str(Path(__file__).resolve().parents[1] / "bench")
    sys.path.insert(0, bench)
    try:
        return importlib.import_module("changing_flights")
    finally:
        sys.path.remove(bench)


def changing_flight(
    cause: str, vehicle: str, at: float, duration: float, seed: int = 1, loop: str = "closed", gusts: float = 0.3
) -> Flight:
    """A flight of the room with a change at an instant [s]."""
    room = changing()
    return room.changing_flight(seed, room.Scenario(cause, vehicle, loop, gusts, duration=duration, time=at)).flight  # type: ignore[no-any-return]


@functools.cache
def alarms(
    cause: str,
    vehicle: str,
    seed: int = 1,
    at: float = 25.0,
    most: float = 10.0,
    loop: str = "closed",
    gusts: float = 0.3,
    touches: tuple[float, float] = (0.0, 0.0),
) -> Sequence[Alarm]:
    """The first alarm of a flight of the room and its revision, from 5 s before the change to `most` seconds after.

    It may have touched down between the times `touches` after the alarm [s].
    """
    flight = changing_flight(cause, vehicle, at, at + most, seed, loop, gusts)
    following, found = Following(LAW), list[Alarm]()
    for part, now in growing(flight, at - 5.0, GLANCE):
        low, high = (found[0].time + after if found else np.inf for after in touches)
        state = following.follow(part, now, low < now < high)
        found += state.alarms if state else ()
        if found and now > found[0].time + max(REVISED, touches[1]) - 0.5 * GLANCE:
            break
    return found


@functools.cache
def of_a_pilot(seed: int, duration: float) -> Sequence[Alarm]:
    """All alarms of a faultless flight whose vehicle brakes when its pilot lets go."""
    flight = changing().piloted_flight(seed, 0.0, duration)
    following = Following(LAW)
    told = (following.follow(part, now) for part, now in growing(flight, following.next_look, GLANCE))
    return tuple(alarm for state in told if state for alarm in state.alarms)
