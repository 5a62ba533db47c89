"""Which frame the lag of x and y sits in while a vehicle turns: the heading's or the world.

    python bench/bench_lag_frames.py [--data DIR]

Log-likelihood of a lag in the world frame less that of a lag that turns with the heading, both with a delay and the
same number of parameters, and the weights of the default laws of x: for the recorded flights of a hexarotor under
velocity commands (DIR/dji-hexarotor), and for rigid bodies of the flight room that fly 60 s of steps or a multisine on
x and y while their heading steps by up to 0.7 rad/s, in calm air: the Tello's velocity loop and the Bebop 2 under
commanded angles. For these also how many of the intervals of steady gain and total lag of x and y hold the small-signal
truth. Seeds 1 and 2.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from bench_other_vehicles import PERIOD, command_of
from rotorfit.app.workflows import load_flight
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import LogSpan
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.flight_room import Conditions, fly_commands, log_of_room_flight
from rotorfit.simulation.vehicle import Vehicle, builtin_vehicles

DATA = Path(__file__).resolve().parents[2] / "shared/data"
PLANE, DURATION, TURN = ("x", "y"), 60.0, 0.7
FRAMES = ("first_order_delay_world_lag", "first_order_delay_lag")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=DATA)
    asked = parser.parse_args()
    for log in sorted((asked.data / "dji-hexarotor").glob("*.mat")):
        print(
            f"{log.name:20}",
            shown(load_flight(LogSpan(str(log), (None, None)), str(log.parent / "card.toml"))),
            flush=True,
        )
    for name in ("tello", "bebop2"):
        vehicle = builtin_vehicles()[name]
        for seed in (1, 2):
            flight = turning(vehicle, seed)
            print(f"{name:14}seed {seed}", shown(flight), held(vehicle, flight), flush=True)


def shown(flight: Flight) -> str:
    """Difference of the log-likelihoods, and the weights of the default laws of x."""
    fits = (fit([flight], axes=PLANE, structure=one) for one in FRAMES)
    world, heading = (one.estimates["x"].optimum.score.log_likelihood for one in fits)
    laws = fit([flight], axes=PLANE).model.axes["x"].laws
    return f"{world - heading:+7.1f}  " + ", ".join(f"{one.structure} {100 * one.weight:.0f} %" for one in laws)


def held(vehicle: Vehicle, flight: Flight) -> str:
    """How many of the four intervals hold the truth."""
    model, truth = fit([flight], axes=PLANE).model, vehicle.linear()
    count = 0
    for k, axis in enumerate(PLANE):
        gain, damping, delay = truth.gamma[2 * k], truth.gamma[2 * k + 1], truth.delay[k]
        for name, value in (("steady_gain", gain / damping), ("total_lag", delay + 1 / damping)):
            low, high = model.axes[axis].combinations[name].ci95
            count += (low is None or low <= value) and (high is None or value <= high)
    return f"hold {count} of 4"


def turning(vehicle: Vehicle, seed: int) -> Flight:
    """A flight of x and y by a vehicle that turns."""
    time, rng = np.arange(0.0, DURATION, PERIOD), np.random.default_rng(seed)
    scale = np.array(vehicle.limits()) / np.array(vehicle.full_scale())
    command = np.zeros((time.size, len(AXES)))
    for k in (0, 1):
        command[:, k] = 0.2 * scale[k] * command_of("steps" if seed % 2 else "multisine", time, k)
    level = rng.choice([-1.0, 1.0], 200) * rng.uniform(0.4, 1.0, 200)
    command[:, 3] = min(TURN / vehicle.limits()[3], 1.0) * scale[3] * level[(time / 2).astype(int)]
    stamps = np.round(time * 1e9).astype(np.int64)
    flown = fly_commands(vehicle, Conditions(), stamps, command, DURATION, seed, (0.0, 0.0, 30.0, 0.0))
    return flight_from_log(log_of_room_flight(flown), card_from_mapping(vehicle.card(), vehicle.name))


if __name__ == "__main__":
    main()
