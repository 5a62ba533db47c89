"""Coverage where the law leaves a term out: what it does to the intervals, and whether it is told.

    python bench/bench_omitted_terms.py [--flights N]

A velocity-commanded vehicle obeys v' = a + c + wind on x and y, where a is g u(t - tau) - b v; or no more than a tilt
of 20 degrees gives; or follows it by no more than 20 m/s^3; or a drag of 0.25 |v| v is taken off it, of a vehicle that
is damped less. It flies 60 s of steps in gusts and turns; poses at 33 Hz with 2 mm of noise, from an integration of its
own. Its law is that of small motion. For each vehicle and size of the steps: the root mean square of what the term adds
over that of the acceleration asked for, the share of the intervals of "the vehicle" (input, damping, delay, x and y)
that hold the law's values, and on how many axes the fit tells of the term, or of another one. The card has no tilt
limit. Seeds: 0 to N - 1.

Then a velocity loop with an integral part, a = 1.2 (u - v) + I, I' = 0.45 (u - v), behind a lag of 0.15 s, whose final
speed is the command: on how many axes the interval of the steady gain holds 1, and the fit tells of a slow part.
"""

import argparse
import os
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array
from rotorfit.core.limits import GRAVITY
from rotorfit.core.model import COEFFICIENTS, Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import builtin_cards

GAIN, DELAY = np.array([4.5, 4.7]), np.array([0.18, 0.17])
STEP, DURATION = 0.01, 60.0


@dataclass(frozen=True)
class Vehicle:
    """A vehicle by what its law leaves out, the sizes of its steps, and its gusts [m/s^2]."""

    omitted: str
    sizes: tuple[float, ...]
    damping: tuple[float, float] = (1.5, 1.8)
    wind: float = 0.3
    bound: float = np.inf
    jerk: float = np.inf
    drag: float = 0.0


VEHICLES = (
    Vehicle("none", (0.4, 0.6, 0.8)),
    Vehicle("bound", (0.4, 0.6, 0.8), bound=GRAVITY * float(np.tan(np.radians(20)))),
    Vehicle("jerk", (0.3, 0.5, 0.7), jerk=20.0),
    Vehicle("none", (0.2, 0.35, 0.5), (0.5, 0.6), 0.1),
    Vehicle("drag", (0.2, 0.35, 0.5), (0.5, 0.6), 0.1, drag=0.25),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--flights", type=int, default=20)
    asked = parser.parse_args()
    card = next(iter(builtin_cards().values()))
    print("omitted  steps  added    hold           told        another")
    for vehicle in VEHICLES:
        for size in vehicle.sizes:
            added, held, told, others = [], [], 0, 0
            for seed in range(asked.flights):
                flight, share = flown(vehicle, size, seed, card)
                model = fit([flight], axes=("x", "y")).model
                added.append(share)
                for k in (0, 1):
                    held += holds(model, vehicle, k)
                    tests = {one.test for one in model.axes[AXES[k]].evidence}
                    told += vehicle.omitted in tests
                    others += bool(tests & {"bound", "jerk", "drag", "slow"} - {vehicle.omitted})
            print(
                f"{vehicle.omitted:7} {size:6.2f} {100 * np.mean(added):5.0f} % {100 * np.mean(held):5.0f} % of "
                f"{len(held):3} {told:5} of {2 * asked.flights:2} {others:5}",
                flush=True,
            )
    integrating(asked.flights, card)


def integrating(flights: int, card: Card) -> None:
    """Prints what is told of a loop with an integral part, by the longest of its steps."""
    print("\nlongest step  holds 1  slow part told")
    for longest in (1.8, 3.0, 9.0):
        held = told = 0
        for seed in range(flights):
            model = fit([looped(longest, seed, card)], axes=("x", "y")).model
            for name in ("x", "y"):
                axis = model.axes[name]
                low, high = axis.combinations["steady_gain"].ci95
                held += (low is None or low <= 1) and (high is None or high >= 1)
                told += any(one.test == "slow" for one in axis.evidence)
        print(f"{longest:10.1f} s {held:4} of {2 * flights} {told:9} of {2 * flights}", flush=True)


def looped(longest: float, seed: int, card: Card) -> Flight:
    """A flight of steps by a velocity loop with an integral part."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 2 * DURATION, STEP)
    command = np.zeros((time.size, 4))
    for k in (0, 1):
        level = rng.choice([-1.0, 1.0], 200) * rng.uniform(0.4, 1.0, 200)
        command[:, k] = level[np.searchsorted(np.cumsum(rng.uniform(0.8, longest, 200)), time)]
    late = np.round(DELAY / STEP).astype(int)
    yaw = 1.5 * np.sin(0.4 * time)
    velocity, position = np.zeros((time.size, 2)), np.zeros((time.size, 2))
    integral, tilt, gust = np.zeros(2), np.zeros(2), np.zeros(2)
    for i in range(1, time.size):
        turn = np.array([[np.cos(yaw[i]), -np.sin(yaw[i])], [np.sin(yaw[i]), np.cos(yaw[i])]])
        error = turn @ command[np.maximum(i - 1 - late, 0), (0, 1)] - velocity[i - 1]
        integral += STEP * 0.45 * error
        tilt += STEP * (1.2 * error + integral - tilt) / 0.15
        gust += -gust * STEP + 0.1 * np.sqrt(2 * STEP) * rng.standard_normal(2)
        velocity[i] = velocity[i - 1] + STEP * (tilt + gust)
        position[i] = position[i - 1] + STEP * (velocity[i] + velocity[i - 1]) / 2
    return assembled(time, command, position + 0.002 * rng.standard_normal(position.shape), yaw, card)


def flown(vehicle: Vehicle, size: float, seed: int, card: Card) -> tuple[Flight, float]:
    """A flight of steps of up to `size`, and how much the omitted term adds to the acceleration asked for."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, DURATION, STEP)
    command = np.zeros((time.size, 4))
    for k in (0, 1):
        level = size * rng.choice([-1.0, 1.0], 200) * rng.uniform(0.4, 1.0, 200)
        command[:, k] = level[np.searchsorted(np.cumsum(rng.uniform(0.4, 1.8, 200)), time)]
    late = np.round(DELAY / STEP).astype(int)
    yaw = 1.5 * np.sin(0.4 * time)
    velocity, position, given, gust = np.zeros((time.size, 2)), np.zeros((time.size, 2)), np.zeros(2), np.zeros(2)
    wanted = added = 0.0
    for i in range(1, time.size):
        turn = np.array([[np.cos(yaw[i]), -np.sin(yaw[i])], [np.sin(yaw[i]), np.cos(yaw[i])]])
        moved = velocity[i - 1] @ turn
        law = GAIN * command[np.maximum(i - 1 - late, 0), (0, 1)] - vehicle.damping * moved
        bounded = law * min(1.0, vehicle.bound / max(float(np.hypot(*law)), 1e-9))
        change = turn @ (bounded - vehicle.drag * np.hypot(*moved) * moved) - given
        given = given + change * min(1.0, vehicle.jerk * STEP / max(float(np.hypot(*change)), 1e-9))
        wanted, added = wanted + float(law @ law), added + float(np.sum((given - turn @ law) ** 2))
        gust += -gust * STEP + vehicle.wind * np.sqrt(2 * STEP) * rng.standard_normal(2)
        velocity[i] = velocity[i - 1] + STEP * (given + gust)
        position[i] = position[i - 1] + STEP * (velocity[i] + velocity[i - 1]) / 2
    noisy = position + 0.002 * rng.standard_normal(position.shape)
    return assembled(time, command, noisy, yaw, card), float(np.sqrt(added / wanted))


def assembled(time: Array, command: Array, position: Array, yaw: Array, card: Card) -> Flight:
    places = np.column_stack([position, np.zeros(time.size)])[::3]
    return Flight(
        path="", sha256="", card=card, span=(0.0, float(time[-1]) + STEP), axes=AXES,
        command_time=time, command=command,
        pose_time=time[::3], position=np.ascontiguousarray(places), yaw=yaw[::3].copy(),
        segments=(Segment(0.0, float(time[-1])),),
    )  # fmt: skip


def holds(model: Model, vehicle: Vehicle, k: int) -> list[bool]:
    """Whether the intervals of an axis hold the law's values."""
    truth = dict(zip(COEFFICIENTS, (GAIN[k], vehicle.damping[k], DELAY[k]), strict=True))
    ends = {name: model.axes[AXES[k]].ci95[name] for name in truth}
    return [
        (low is None or low <= truth[name]) and (high is None or truth[name] <= high)
        for name, (low, high) in ends.items()
    ]


if __name__ == "__main__":
    main()
