"""Lateness of commands: 100 Hz over UDP to a vehicle in a process of its own, while every core is busy.

    python bench/bench_jitter.py [SECONDS]

Prints the lateness of the commands for an idle and a busy computer, with and without real-time priority, and that of a
loop that only sleeps for a period, for comparison.
"""

import multiprocessing
import os
import select
import socket
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from rotorfit.core.flight_plan import AxisExcitation, Feedback, Plan, Space
from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying import operator as realtime
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.links.link import Action, seconds_until, wall_clock
from rotorfit.flying.recorder import record
from rotorfit.planning.belief import belief_from_card, belief_mapping
from rotorfit.planning.signals import paper_sines
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.vehicle import load_vehicle

RATE, BEBOP = 100.0, load_vehicle("bebop2")
POSE, COMMAND = struct.Struct("<q7d"), struct.Struct("<4d")


def vehicle(ready: "multiprocessing.synchronize.Event", port: int, own: int) -> None:
    """The virtual flight room at the pace of the wall clock: commands in, samples out."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", own))
    room = FlightRoom(BEBOP, Conditions(), 1)
    room.advance(1_000_000)
    began = wall_clock()
    ready.set()
    while True:
        if select.select([sock], [], [], 0.002)[0]:
            room.send(COMMAND.unpack(sock.recv(100)))
        for one in room.advance(max(room.now, wall_clock() - began)):
            if one.stream == "pose":
                sock.sendto(POSE.pack(began + one.stamp, *one.values), ("127.0.0.1", port))


class UdpLink:
    """Commands and poses as packets on this computer; implements `links.Link`."""

    live, fail_safe = True, "A bench."

    def __init__(self, port: int, other: int, spin: float = 0.0) -> None:
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sock.bind(("127.0.0.1", port))
        self._sock.setblocking(False)
        self._other, self._spin = ("127.0.0.1", other), spin

    @property
    def now(self) -> int:
        return wall_clock()

    def send(self, command: Sequence[float]) -> None:
        self._sock.sendto(COMMAND.pack(*command), self._other)

    def receive(self, until: int) -> list[Sample]:
        samples = []
        while (left := seconds_until(until) - self._spin) > 0:
            if select.select([self._sock], [], [], left)[0]:
                stamp, *values = POSE.unpack(self._sock.recv(100))
                samples.append(Sample("pose", stamp, wall_clock(), tuple(values)))
        while wall_clock() < until:
            pass
        return samples

    def act(self, action: Action) -> None:
        pass


def plan_of(duration: float) -> Plan:
    card = card_from_mapping(BEBOP.card(), "bench")
    signals = tuple(AxisExcitation(axis, "command", 0.0, duration, paper_sines(axis, 0.5)) for axis in ("x", "y"))
    space = Space((-3.0, -3.0, 0.3), (3.0, 3.0, 3.0), (0.0, 0.0, 1.5, 0.0), 2.5, 1.5)
    steering = Feedback(("x", "y", "z", "yaw"))
    belief = belief_mapping(belief_from_card(card))
    return Plan("bench", "two_sines", BEBOP.card(), RATE, duration, 1.0, signals, steering, space, belief)


def flight(duration: float, port: int, spin: float) -> str:
    ready = multiprocessing.Event()
    other = multiprocessing.Process(target=vehicle, args=(ready, port, port + 1), daemon=True)
    other.start()
    ready.wait(60)
    try:
        with tempfile.TemporaryDirectory() as folder:
            link = UdpLink(port, port + 1, spin)
            while len(link.receive(link.now + 500_000_000)) < 20:  # until the room keeps up
                pass
            plan = plan_of(duration)
            result = fly(plan, link, record(Path(folder) / "log.mcap", {}), land=False)
    finally:
        other.kill()
    return told([result.jitter.p50, result.jitter.p99, result.jitter.max]) + f"  {result.reason}, {result.late} late"


def sleeping(duration: float) -> str:
    """What `time.sleep(0.01)` in a loop gives: the period by which each instant is late on a steady clock."""
    due, late = time.monotonic(), []
    for _ in range(round(duration * RATE)):
        due += 1 / RATE
        time.sleep(1 / RATE)
        late.append(time.monotonic() - due)
    steps = np.diff(late, prepend=0.0)
    return told(np.quantile(np.abs(steps), [0.5, 0.99, 1.0])) + f"  and {late[-1]:.2f} s behind at the end"


def told(late: Sequence[float]) -> str:
    return "  ".join(f"{1e3 * value:8.3f}" for value in late)


def busy() -> None:
    while True:
        sum(range(10_000))


def row(name: str, run: Callable[[], str]) -> None:
    print(f"{name:44s}{run()}", flush=True)


def main() -> None:
    duration = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    cores = os.cpu_count() or 1
    print(f"{cores} cores, {duration:g} s at {RATE:g} Hz; other work on this computer: load {os.getloadavg()[0]:.1f}")
    print(f"{'lateness [ms]':44s}{'50 %':>8s}  {'99 %':>8s}  {'most':>8s}")
    schedule = realtime._schedule
    row("idle, real time", lambda: flight(duration, 47100, 0.0))
    crowd = [multiprocessing.Process(target=busy, daemon=True) for _ in range(cores)]
    for one in crowd:
        one.start()
    try:
        row("busy, real time", lambda: flight(duration, 47110, 0.0))
        row("busy, real time, spins for 0.2 ms", lambda: flight(duration, 47120, 0.0002))
        realtime._schedule = lambda *_: False
        row("busy, ordinary priority", lambda: flight(duration, 47130, 0.0))
        row("busy, ordinary priority, spins for 0.2 ms", lambda: flight(duration, 47140, 0.0002))
        row("busy, a loop that sleeps for a period", lambda: sleeping(duration))
    finally:
        realtime._schedule = schedule
        for one in crowd:
            one.kill()


if __name__ == "__main__":
    main()
