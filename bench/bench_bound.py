"""Coverage below a bound on the acceleration: what a limit of tilt does to the intervals, and whether it is told.

    python bench/bench_bound.py [--flights N]

A velocity-commanded vehicle obeys v' = g u(t - tau) - b v + c + wind on x and y, but accelerates by no more than a tilt
of 20 degrees gives. It flies 60 s of steps in gusts of 0.3 m/s^2 and turns; poses at 33 Hz with 2 mm of noise, from an
integration of its own. Its law is that of small motion. For steps of three sizes, with the bound and without: the share
of the acceleration asked for that the bound takes off, the share of the intervals of "the vehicle" (input, damping,
delay, x and y) that hold the truth, and on how many axes the fit tells of a bound. The card has no tilt limit. Seeds: 0
to N - 1.
"""

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array
from rotorfit.core.limits import GRAVITY
from rotorfit.core.model import COEFFICIENTS, Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import builtin_cards

GAIN, DAMPING, DELAY = np.array([4.5, 4.7]), np.array([1.5, 1.8]), np.array([0.18, 0.17])
BOUND = GRAVITY * np.tan(np.radians(20))
SIZES = (0.4, 0.6, 0.8)
STEP, DURATION, WIND = 0.01, 60.0, 0.3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--flights", type=int, default=20)
    asked = parser.parse_args()
    card = next(iter(builtin_cards().values()))
    print("steps  bound  taken off   hold   told")
    for size in SIZES:
        for bound in (BOUND, np.inf):
            taken, held, told = [], [], []
            for seed in range(asked.flights):
                flight, share = flown(size, bound, seed, card)
                model = fit([flight], axes=("x", "y")).model
                taken.append(share)
                held += [inside for k in (0, 1) for inside in holds(model, k)]
                told += [any(one.test == "bound" for one in model.axes[AXES[k]].evidence) for k in (0, 1)]
            print(
                f"{size:5.1f} {bound:6.2f} {100 * np.mean(taken):8.1f} % {100 * np.mean(held):5.0f} % of {len(held):3} "
                f"{sum(told):3} of {len(told)}"
            )


def flown(size: float, bound: float, seed: int, card: Card) -> tuple[Flight, float]:
    """A flight of steps of up to `size`, and the share of the acceleration asked for that the bound takes off."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, DURATION, STEP)
    command = np.zeros((time.size, 4))
    for k in (0, 1):
        level = size * rng.choice([-1.0, 1.0], 200) * rng.uniform(0.4, 1.0, 200)
        command[:, k] = level[np.searchsorted(np.cumsum(rng.uniform(0.4, 1.8, 200)), time)]
    late = np.round(DELAY / STEP).astype(int)
    yaw = 1.5 * np.sin(0.4 * time)
    velocity, position, gust = np.zeros((time.size, 2)), np.zeros((time.size, 2)), np.zeros(2)
    wanted = given = 0.0
    for i in range(1, time.size):
        turn = np.array([[np.cos(yaw[i]), -np.sin(yaw[i])], [np.sin(yaw[i]), np.cos(yaw[i])]])
        acceleration = GAIN * command[np.maximum(i - 1 - late, 0), (0, 1)] - DAMPING * (velocity[i - 1] @ turn)
        asked = float(np.hypot(*acceleration))
        acceleration *= min(1.0, bound / max(asked, 1e-9))
        wanted, given = wanted + asked, given + float(np.hypot(*acceleration))
        gust += -gust * STEP + WIND * np.sqrt(2 * STEP) * rng.standard_normal(2)
        velocity[i] = velocity[i - 1] + STEP * (turn @ acceleration + gust)
        position[i] = position[i - 1] + STEP * (velocity[i] + velocity[i - 1]) / 2
    return assembled(
        time, command, position + 0.002 * rng.standard_normal(position.shape), yaw, card
    ), 1 - given / wanted


def assembled(time: Array, command: Array, position: Array, yaw: Array, card: Card) -> Flight:
    places = np.column_stack([position, np.zeros(time.size)])[::3]
    return Flight(
        path="", sha256="", card=card, span=(0.0, DURATION), axes=AXES, command_time=time, command=command,
        pose_time=time[::3], position=np.ascontiguousarray(places), yaw=yaw[::3].copy(),
        segments=(Segment(0.0, float(time[-1])),),
    )  # fmt: skip


def holds(model: Model, k: int) -> list[bool]:
    """Whether the intervals of an axis hold the truth."""
    truth = dict(zip(COEFFICIENTS, (GAIN[k], DAMPING[k], DELAY[k]), strict=True))
    ends = {name: model.axes[AXES[k]].ci95[name] for name in truth}
    return [
        (low is None or low <= truth[name]) and (high is None or truth[name] <= high)
        for name, (low, high) in ends.items()
    ]


if __name__ == "__main__":
    main()
