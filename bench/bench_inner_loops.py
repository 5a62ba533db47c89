"""Do the intervals hold where the inner loop is of the second order, or its one lag as slow as the damping?

    python bench/bench_inner_loops.py [--flights N] [--turn RADIANS] [--gust M/S^2] [--first K]

A velocity loop a = k (u - v) in the world, behind an attitude loop of the second order (natural frequency w, damping
ratio 0.8), with drag 0.3 and 0.055 s of delay: steady gain k / (k + 0.3) and total lag are known. The next three have
one lag instead; only that of the third gives real poles, as the default laws assume. The last three have no loop, and
obey the law with a lag exactly: its lag is 1 / b, or shorter. 45 s of steps of up to 2.5 s on x and y, from the first
instant on, pulled back to the start by the pilot, in gusts (default 0.15 m/s^2); the heading swings by RADIANS (default
0); poses at 100 Hz with 0.6 mm of noise, from an integration of its own. For each vehicle: how many of the intervals of
"the vehicle" hold, their median width over the truth, how many would hold under the fit's own law alone ("this
flight"), and on how many axes the fit tells of another law ("order"). Seeds: 0 to N - 1. `--first` leaves vehicles out.
"""

import argparse
import os
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import Array
from rotorfit.core.model import Axis, Interval
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import builtin_cards

CARD = next(iter(builtin_cards().values()))
STEP, DURATION, DRAG, DELAY, RATIO = 0.001, 45.0, 0.3, 0.055, 0.8


@dataclass(frozen=True)
class Vehicle:
    """Gain of the velocity loop [1/s], and of the attitude loop its natural frequency [rad/s] or its one lag [s].

    Without a loop, the gain is the acceleration per command.
    """

    gain: float
    frequency: float = 0.0
    one_lag: float = 0.0
    drag: float = DRAG
    loop: bool = True

    @property
    def truths(self) -> dict[str, float]:
        """At low frequencies: v / u = k e^(-0.055 s) / ((1 + lag s) (s + drag) + k), without the last k in no loop."""
        lag = 2 * RATIO / self.frequency if self.frequency else self.one_lag
        slow = self.drag + self.gain * self.loop
        told = {"steady_gain": self.gain / slow, "total_lag": DELAY + (1 + lag * self.drag) / slow}
        return told if self.loop else {"input": self.gain, "damping": self.drag, **told}


VEHICLES = (
    Vehicle(2.8, frequency=14.0),
    Vehicle(2.8, frequency=25.0),
    Vehicle(1.6, frequency=14.0),
    Vehicle(2.8, one_lag=0.1),
    Vehicle(1.2, one_lag=0.3),
    Vehicle(1.6, one_lag=0.1),
    Vehicle(2.857, one_lag=0.35, drag=2.857, loop=False),
    Vehicle(2.857, one_lag=0.25, drag=2.857, loop=False),
    Vehicle(2.857, one_lag=0.25, drag=1.5, loop=False),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--flights", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the first vehicle")
    parser.add_argument("--gust", type=float, default=0.15, help="standard deviation of the gusts [m/s^2]")
    parser.add_argument("--turn", type=float, default=0.0, help="amplitude of the heading [rad]")
    asked = parser.parse_args()
    print("| loop, or gain and drag [1/s] | attitude | quantity | held | width | held, this flight | told |")
    print("|--:|---|---|--:|--:|--:|--:|")
    for vehicle in VEHICLES[asked.first :]:
        axes = [
            axis
            for seed in range(asked.flights)
            for axis in fit([flown(vehicle, seed, asked.turn, asked.gust)], axes=("x", "y")).model.axes.values()
            if axis.predictor
        ]
        told = sum(any(one.test in ("order", "twice") for one in axis.evidence) for axis in axes)
        inner = f"{vehicle.frequency:g} rad/s" if vehicle.frequency else f"{vehicle.one_lag:g} s"
        for name, truth in vehicle.truths.items():
            loop = f"{vehicle.gain}" if vehicle.loop else f"{vehicle.gain}, {vehicle.drag}"
            print(f"| {loop} | {inner} | {name} | {counted(axes, name, truth)} | {told} |", flush=True)


def counted(axes: list[Axis], name: str, truth: float) -> str:
    if name in ("input", "damping"):
        vehicle, flight = [axis.ci95[name] for axis in axes], [(axis.ci95_flight or axis.ci95)[name] for axis in axes]
    else:
        parts = [axis.combinations[name] for axis in axes]
        vehicle, flight = [part.ci95 for part in parts], [part.ci95_flight or part.ci95 for part in parts]
    width = np.median([high - low for low, high in vehicle if low is not None and high is not None])
    return f"{held(vehicle, truth)} of {len(axes)} | {100 * width / truth:.0f} % | {held(flight, truth)}"


def held(intervals: list[Interval], truth: float) -> int:
    return sum((low is None or low <= truth) and (high is None or truth <= high) for low, high in intervals)


def flown(vehicle: Vehicle, seed: int, turn: float, gusts: float = 0.15) -> Flight:
    """x and y, by explicit Euler."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, DURATION, STEP)
    sticks = np.zeros((time.size, 2))
    for k in range(2):
        level = 0.6 * rng.choice([-1.0, 1.0], 200) * rng.uniform(0.4, 1.2, 200)
        sticks[:, k] = level[np.searchsorted(np.cumsum(rng.uniform(0.5, 2.5, 200)), time)]
    yaw, late = turn * np.sin(0.5 * time), round(DELAY / STEP)
    command, position = np.zeros((time.size, 4)), np.zeros((time.size, 2))
    velocity, tilt, rate, gust = (np.zeros(2) for _ in range(4))
    for i in range(1, time.size):
        turned = world(yaw[i])
        if i % 70 == 1:  # 14 commands a second
            command[i, :2] = np.clip(sticks[i] - 0.375 * position[max(i - 150, 0)] @ turned, -1.0, 1.0)
        else:
            command[i] = command[i - 1]
        asked = vehicle.gain * (turned @ command[max(i - late, 0), :2] - velocity * vehicle.loop)
        if vehicle.frequency:
            swing = 2 * RATIO * vehicle.frequency * rate
            rate += STEP * (vehicle.frequency**2 * (asked - tilt) - swing)
            tilt = tilt + STEP * rate
        else:
            tilt = tilt + STEP * (asked - tilt) / vehicle.one_lag
        gust += -gust * STEP / 0.8 + gusts * np.sqrt(2 * STEP / 0.8) * rng.standard_normal(2)
        velocity = velocity + STEP * (tilt - vehicle.drag * velocity + gust)
        position[i] = position[i - 1] + STEP * velocity
    seen = slice(0, None, 10)
    noise = 0.0006 * rng.standard_normal((time[seen].size, 3))
    place = np.column_stack([position[seen], np.zeros(time[seen].size)]) + noise
    return Flight(
        path=f"{vehicle} {seed}", sha256=f"{vehicle} {seed}", card=CARD,
        span=(0.0, DURATION), axes=("x", "y"), command_time=time[1::70], command=command[1::70], pose_time=time[seen],
        position=place, yaw=yaw[seen], segments=(Segment(0.0, DURATION),),
    )  # fmt: skip


def world(yaw: float) -> Array:
    return np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])


if __name__ == "__main__":
    main()
