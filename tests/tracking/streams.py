"""A simulated flight as the samples of a link, from the ground to the ground, and the faults that streams have."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying.links.sim import SimLink
from rotorfit.flying.links.sim_pilot import PilotedRoom
from rotorfit.simulation.air import wind_of
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.vehicle import load_vehicle

BEBOP = load_vehicle("bebop2")
CARD = card_from_mapping(BEBOP.card(), BEBOP.name)
SECOND = 1_000_000_000

Fault = Callable[[list[Sample], np.random.Generator], list[Sample]]


@cache
def flown(seconds: float = 40.0, seed: int = 1, ground: bool = True) -> tuple[Sample, ...]:
    """On the ground, take-off under commands of zero, the pilot's flight, a landing under commands of zero."""
    pilot = replace(BEBOP.autopilot, brakes_on_zero=False)  # which is another vehicle wherever nothing is asked
    start = (0.0, 0.0, 0.0 if ground else 1.5, 0.0)
    vehicle, air = replace(BEBOP, autopilot=pilot), Conditions(wind_of(["gusts=0.2"], "gusts=0.2"))
    room = SimLink(FlightRoom(vehicle, air, seed, start, not ground))
    out: list[Sample] = []

    def idle(until: int) -> None:
        while room.now < until:
            out.append(Sample("command", room.now, room.now, (0.0, 0.0, 0.0, 0.0)))
            out.extend(room.receive(room.now + SECOND // 50))

    if ground:
        idle(room.now + 3 * SECOND)
        room.act("take_off")
        idle(room.now + 6 * SECOND)
    out += PilotedRoom(room, CARD, seconds).receive(room.now + round(seconds * SECOND))
    if ground:
        idle(room.now + 2 * SECOND)
        room.act("land")
        idle(room.now + 8 * SECOND)
    return tuple(sorted(out, key=lambda one: one.received))


def late(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    """Some arrive up to 0.3 s later than they were stamped, out of order."""
    moved = [
        replace(one, received=one.received + int(rng.uniform(0, 0.3) * SECOND)) if rng.random() < 0.05 else one
        for one in samples
    ]
    return sorted(moved, key=lambda one: one.received)


def doubled(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    return [copy for one in samples for copy in [one] * (2 if rng.random() < 0.05 else 1)]


def lost(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    return [one for one in samples if rng.random() > 0.1]


def paused(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    """Everything is silent for a while, twice."""
    for _ in range(2):
        begin = rng.uniform(samples[0].received, samples[-1].received)
        end = begin + rng.uniform(0.2, 6.0) * SECOND
        samples = [one for one in samples if not begin < one.received < end]
    return samples


def without_commands(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    """The one who commands is silent for so short a time that the vehicle goes on as told."""
    begin = rng.uniform(samples[0].received, samples[-1].received)
    end = begin + rng.uniform(0.1, 0.4) * SECOND
    return [one for one in samples if one.stream != "command" or not begin < one.received < end]


def without_poses(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    begin = rng.uniform(samples[0].received, samples[-1].received)
    end = begin + rng.uniform(0.2, 8.0) * SECOND
    return [one for one in samples if one.stream != "pose" or not begin < one.received < end]


def other_clock(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    """Commands are stamped by a clock of their own."""
    offset = int(rng.choice([-1, 1]) * rng.uniform(5, 1e6) * SECOND)
    return [replace(one, stamp=one.stamp + offset) if one.stream == "command" else one for one in samples]


def wild_stamps(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    return [
        replace(one, stamp=int(rng.choice([0, 2**62, one.stamp + 10**13, one.stamp - 10**13])))
        if rng.random() < 0.01
        else one
        for one in samples
    ]


def no_numbers(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    def spoilt(one: Sample) -> Sample:
        values = list(one.values)
        values[rng.integers(len(values))] = float(rng.choice([np.nan, np.inf, -np.inf, 1e300]))
        return replace(one, values=tuple(values))

    return [spoilt(one) if one.values and rng.random() < 0.02 else one for one in samples]


def wild_poses(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    """Single poses lie somewhere else."""
    return [
        replace(one, values=(*(rng.uniform(-5, 5, 3) + 6.0).tolist(), *one.values[3:]))
        if one.stream == "pose" and rng.random() < 0.004
        else one
        for one in samples
    ]


def turned_signs(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    """A quaternion and its negative are one attitude."""
    return [
        replace(one, values=(*one.values[:3], *(-part for part in one.values[3:])))
        if one.stream == "pose" and rng.random() < 0.3
        else one
        for one in samples
    ]


def repeated_poses(samples: list[Sample], rng: np.random.Generator) -> list[Sample]:
    """Some poses come again with a fresh stamp."""
    out, last = [], None
    for one in samples:
        if one.stream == "pose":
            one = replace(one, values=last.values) if last and rng.random() < 0.1 else one
            last = one
        out.append(one)
    return out


FAULTS: tuple[Fault, ...] = (
    late, doubled, lost, paused, without_commands, without_poses, other_clock, wild_stamps, no_numbers, wild_poses,
    turned_signs, repeated_poses,
)  # fmt: skip
"""Those that are no alarm."""


def frozen(samples: Sequence[Sample], at: float, seconds: float) -> list[Sample]:
    """The pose of an instant, again and again."""
    begin = samples[0].received + round(at * SECOND)
    end, held, out = begin + round(seconds * SECOND), None, []
    for one in samples:
        if one.stream == "pose" and begin <= one.received < end:
            held = held or one.values
            one = replace(one, values=held)
        out.append(one)
    return out


def jumped(samples: Sequence[Sample], at: float, by: Sequence[float]) -> list[Sample]:
    """From an instant on the poses are somewhere else."""
    begin = samples[0].received + round(at * SECOND)
    return [
        replace(one, values=(*(a + b for a, b in zip(one.values[:3], by, strict=True)), *one.values[3:]))
        if one.stream == "pose" and one.received >= begin
        else one
        for one in samples
    ]


def reset(samples: Sequence[Sample], at: float, angle: float) -> list[Sample]:
    """From an instant on the heading is another one [rad], as after the reset of an estimator."""
    begin, c, s = samples[0].received + round(at * SECOND), np.cos(angle / 2), np.sin(angle / 2)
    out = []
    for one in samples:
        if one.stream == "pose" and one.received >= begin:
            w, x, y, z = one.values[3:]
            turned = (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)
            one = replace(one, values=(*one.values[:3], *(float(each) for each in turned)))
        out.append(one)
    return out


def mixed(samples: Sequence[Sample], seed: int) -> list[Sample]:
    """A random mixture of the faults that are no alarm."""
    rng = np.random.default_rng(seed)
    out = list(samples)
    for fault in rng.permutation(np.array(FAULTS, dtype=object))[: rng.integers(1, 6)]:
        out = fault(out, rng)
    return out
