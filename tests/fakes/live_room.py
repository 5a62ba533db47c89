"""The virtual flight room on the wall clock, for fake vehicles that real middleware talks to."""

import argparse
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

from rotorfit.core.log import Sample
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.sensors import Mocap
from rotorfit.simulation.vehicle import load_vehicle

JUMP = 1.5
"""How far poses lie from the truth along x once the motion capture takes another body for this one [m]."""


class LiveRoom:
    """A FlightRoom that is advanced to now whenever somebody looks or sends; keeps what arrived, and when.

    Attributes:
        arrived: The commands by the wall clock [ns].
        fault: Of the poses: `stale`, they repeat; `jump`, they lie beside the vehicle; empty, there is none.
        ahead: How far the clock of the stamps is ahead of the wall clock [ns].
    """

    def __init__(self, room: Any) -> None:
        room.advance(room.now + 1)  # compiles the kernel before the clock starts
        self._room = room
        self._start = time.monotonic_ns() - room.now  # the vehicle's motion does not jump with the clock of its stamps
        self._ahead: list[Sample] = []
        self._last: tuple[float, ...] = ()
        self.arrived: list[tuple[int, tuple[float, ...]]] = []
        self.fault, self.ahead = "", 0

    def wall(self, instant: int) -> int:
        """The clock of the stamps at an instant of the room [ns]."""
        return time.time_ns() + self.ahead - self.now() + instant

    def now(self) -> int:
        """The room's instant [ns]."""
        return time.monotonic_ns() - self._start

    def send(self, command: Sequence[float]) -> None:
        self.arrived.append((time.time_ns(), tuple(command)))
        self._catch_up()
        self._room.send(command)

    def take_off(self) -> None:
        self._catch_up()
        self._room.take_off()

    def land(self) -> None:
        self._catch_up()
        self._room.land()

    def mode(self) -> str:
        """`grounded`, `taking_off`, `flying` or `landing`."""
        return str(self._room.truth().mode)

    def samples(self) -> list[Sample]:
        """What the sensors have delivered since the last call."""
        self._catch_up()
        found, self._ahead = self._ahead, []
        return [self._seen(sample) if sample.stream == "pose" else sample for sample in found]

    def _seen(self, pose: Sample) -> Sample:
        """A pose as the motion capture has it."""
        if self.fault == "stale" and self._last:
            return replace(pose, values=self._last)
        x, *rest = self._last = pose.values
        return replace(pose, values=(x + JUMP, *rest)) if self.fault == "jump" else pose

    def _catch_up(self) -> None:
        self._ahead += self._room.advance(max(self.now(), self._room.now))


def arguments(vehicle: str, mocap: Mocap) -> tuple[argparse.ArgumentParser, Callable[[argparse.Namespace], LiveRoom]]:
    """Options that all fakes have, and how to make the room from them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--vehicle", default=vehicle)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--grounded", action="store_true")
    parser.add_argument("--arrivals", type=Path, help="file for the commands as they arrived, written at the end")

    def room(options: argparse.Namespace) -> LiveRoom:
        flying = not options.grounded
        start = (0.0, 0.0, 1.5 if flying else 0.0, 0.0)
        conditions = Conditions(mocap=replace(mocap))
        return LiveRoom(FlightRoom(load_vehicle(options.vehicle), conditions, options.seed, start, flying))

    return parser, room


def run_until_told(step: Callable[[], None], room: LiveRoom, arrivals: Path | None) -> None:
    """Calls `step` again and again until SIGTERM, SIGINT or the end of the parent, then writes what arrived.

    From SIGUSR1 on poses are stale, from SIGUSR2 on they have jumped, from SIGHUP on their clock is 30 s ahead.
    """
    told: list[int] = []

    def stop(number: int, _frame: FrameType | None) -> None:
        told.append(number)

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGUSR1, lambda *_: setattr(room, "fault", "stale"))
    signal.signal(signal.SIGHUP, lambda *_: setattr(room, "ahead", 30_000_000_000))
    signal.signal(signal.SIGUSR2, lambda *_: setattr(room, "fault", "jump"))
    parent = os.getppid()
    print("ready", flush=True)
    while not told and os.getppid() == parent:
        step()
    if arrivals:
        arrivals.write_text(json.dumps(room.arrived), encoding="utf-8")
    sys.exit(0)


def yaw_of(pose: Sequence[float]) -> float:
    """Heading of a pose as a Sample has it [rad]."""
    w, x, y, z = pose[3:]
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
