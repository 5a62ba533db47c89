"""Coverage on vehicles that do not obey the estimator's equations: full rigid bodies, every design.

    python bench/bench_other_vehicles.py [--vehicles bebop2,tello,...] [--structures averaged,first_order_delay]

The flight room's vehicles (rigid body, rotors, attitude loop and, where they have one, velocity loop) fly 60 s of
steps, of a multisine and of two sines, small and large, in calm and in gusty air, x and y, then z and yaw. For steady
gain and total lag, whose true values for small slow motion `Vehicle.linear` computes from the parameters: the share of
the intervals of "this flight" and of "the vehicle" that contain them, and the median of the ratio of their widths. Then
the six flights with small commands are fitted together. Seed: the number of the flight.
"""

import argparse
import os
from collections import defaultdict

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.flight_plan import value
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import Interval, Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.signals import doublets, multisine, paper_sines
from rotorfit.simulation.air import Gusts, Wind
from rotorfit.simulation.flight_room import Conditions, fly_commands, log_of_room_flight
from rotorfit.simulation.vehicle import Vehicle, builtin_vehicles

DURATION, PERIOD = 60.0, 0.033
BAND = (0.8, 6.0)
SIZES = {"small": 0.12, "large": 0.35}
"""Share of the limit of a command."""

AIR = {"calm": Wind(), "gusty": Wind(gusts=Gusts((0.5, 0.5, 0.3)))}
DESIGNS = ("steps", "multisine", "two sines")
TOLD = ("steady_gain", "total_lag")


def command_of(design: str, time: Array, k: int) -> Array:
    """Of one axis, of size 1 at most."""
    match design:
        case "steps":
            raw = value(doublets(1.0, DURATION, BAND, k % 2), time)
        case "multisine":
            raw = value(multisine(1.0, DURATION, BAND, k % 2, 2), time)
        case _:
            raw = value(paper_sines(AXES[k]), time)
    return np.asarray(raw / np.abs(raw).max())


def flown(vehicle: Vehicle, design: str, size: float, wind: Wind, axes: tuple[int, int], seed: int) -> Flight:
    time = np.arange(0.0, DURATION, PERIOD)
    command = np.zeros((time.size, 4))
    scale = np.array(vehicle.limits()) / np.array(vehicle.full_scale())
    for k in axes:
        command[:, k] = size * scale[k] * command_of(design, time, k)
    stamps = np.round(time * 1e9).astype(np.int64)
    flight = fly_commands(vehicle, Conditions(wind=wind), stamps, command, DURATION, seed, (0.0, 0.0, 40.0, 0.0))
    return flight_from_log(log_of_room_flight(flight), card_from_mapping(vehicle.card(), vehicle.name))


def holds(ends: Interval, truth: float) -> bool:
    low, high = ends
    return (low is None or low <= truth) and (high is None or truth <= high)


class Count:
    """Intervals of one kind of flight."""

    def __init__(self) -> None:
        self.flight: list[bool] = []
        self.vehicle: list[bool] = []
        self.ratio: list[float] = []
        self.missing = 0

    def add(self, model: Model, vehicle: Vehicle, axes: tuple[int, int]) -> None:
        truth = vehicle.linear()
        for k in axes:
            g, b, delay = *truth.gamma[2 * k : 2 * k + 2], truth.delay[k]
            known, true = model.axes[AXES[k]], {"steady_gain": g / b, "total_lag": delay + 1 / b}
            for name in TOLD:
                part = known.combinations.get(name)
                if part is None or part.ci95 == (None, None) or part.ci95_flight is None:
                    self.missing += 1
                    continue
                self.flight.append(holds(part.ci95_flight, true[name]))
                self.vehicle.append(holds(part.ci95, true[name]))
                if None not in (*part.ci95, *part.ci95_flight):
                    self.ratio.append(float(np.ptp(np.array(part.ci95)) / np.ptp(np.array(part.ci95_flight))))

    def row(self) -> str:
        share = [f"{100 * np.mean(held):.0f} %" if held else "-" for held in (self.flight, self.vehicle)]
        width = f"{np.median(self.ratio):.2f}" if self.ratio else "-"
        return f"{len(self.flight)} | {self.missing} | {share[0]} | {share[1]} | {width}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", default="bebop2,tello,m100,crazyflie")
    parser.add_argument("--structures", default="averaged")
    options = parser.parse_args()
    for structure in options.structures.split(","):
        counts: dict[str, Count] = defaultdict(Count)
        for name in options.vehicles.split(","):
            vehicle = builtin_vehicles()[name]
            for axes in ((0, 1), (2, 3)):
                flights, seed = {}, 0
                for design in DESIGNS:
                    for air, wind in AIR.items():
                        for size, share in SIZES.items():
                            seed += 1
                            flights[design, air, size] = flown(vehicle, design, share, wind, axes, seed)
                moved = [AXES[k] for k in axes]
                for (design, air, size), flight in flights.items():
                    model = fit([flight], axes=moved, structure=structure).model
                    for group in ("all single flights", design, air, size, name):
                        counts[group].add(model, vehicle, axes)
                six = [flight for (_, _, size), flight in flights.items() if size == "small"]
                counts["six flights together"].add(fit(six, axes=moved, structure=structure).model, vehicle, axes)
            print(name, flush=True)
        print(f"\n`{structure}`\n\n| flights | intervals | none | this flight | the vehicle | width |")
        print("|---|---|---|---|---|---|")
        for group, count in counts.items():
            print(f"| {group} | {count.row()} |")


if __name__ == "__main__":
    main()
