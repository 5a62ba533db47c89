"""Estimates in the virtual flight room, compared with the coefficients of `Vehicle.linear`.

    python bench/bench_linear_truth.py

Each vehicle flies 100 s in calm air, 1 mm mocap noise, a radio without jitter, a soft start; x with y, and z with yaw:
slow (0.10 to 0.37 rad/s), usual (0.5 to 2.3 rad/s), and usual but wide (three times the amplitude); then all four axes
at once, so that it flies while it turns. Printed is the difference of the fit (method ml, `first_order_delay`) from the
linear truth: the error of a first-order model with a delay.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from rotorfit.core.flight_plan import Sines, value
from rotorfit.core.model import Axis
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.flight_room import Conditions, fly_commands, log_of_room_flight
from rotorfit.simulation.sensors import Mocap
from rotorfit.simulation.vehicle import Radio, Vehicle, builtin_vehicles

SLOW, USUAL = (0.10, 0.16, 0.24, 0.37), (0.5, 1.0, 1.6, 2.3)
XY, ZYAW, ALL = ("x", "y"), ("z", "yaw"), ("x", "y", "z", "yaw")
CASES = (
    *(("slow", SLOW, 0.15, XY), ("slow", SLOW, 0.15, ZYAW), ("usual", USUAL, 0.15, XY), ("usual", USUAL, 0.15, ZYAW)),
    *(("wide", USUAL, 0.45, XY), ("wide", USUAL, 0.45, ZYAW), ("turning", USUAL, 0.15, ALL)),
)
DURATION, RADIO = 100.0, Radio(0.03)
ROOM = Conditions(mocap=Mocap(noise=0.001, turn_noise=0.001, latency=0.0, jitter=0.0), radio=RADIO)


def flown(vehicle: Vehicle, frequency: tuple[float, ...], size: float, moved: tuple[str, ...]) -> dict[str, Axis]:
    t = np.arange(0, DURATION, 0.02)
    phase = [tuple(a + 1.3 * a * k * k for k in range(4)) for a in (0.3, 1.0, 2.0, 0.7)]
    waves = np.stack([value(Sines((0.25,) * 4, frequency, p), t) for p in phase], axis=1)
    servo = np.array([1 + (vehicle.command.horizontal == "velocity")] * 2 + [2, 2])
    servo *= [axis in moved for axis in ALL]
    commands = size * servo * waves * np.minimum(1, t / 5)[:, None] * np.array(vehicle.limits()) / vehicle.full_scale()
    stamps = np.round(t * 1e9).astype(np.int64)
    flight = fly_commands(vehicle, ROOM, stamps, commands, DURATION, 1, (0.0, 0.0, 30.0, 0.0))
    read = flight_from_log(log_of_room_flight(flight), card_from_mapping(vehicle.card(), vehicle.name))
    return dict(fit([read], axes=moved, structure="first_order_delay").model.axes)


def main() -> None:
    print(f"{'':24}{'input':>8}{'damping':>9}{'delay':>10}{'steady gain':>13}{'total lag':>11}")
    for name, vehicle in builtin_vehicles().items():
        truth = vehicle.linear(RADIO)
        for case, frequency, size, moved in CASES:
            axes = flown(vehicle, frequency, size, moved)
            for axis in moved:
                k = ALL.index(axis)
                g, d, delay, found = *truth.gamma[2 * k : 2 * k + 2], truth.delay[k], axes[axis].predictor
                if found is None:
                    print(f"{name:10} {case:8} {axis:4} not excited")
                    continue
                gain = found.input / found.damping / (g / d) - 1
                lag = (found.delay + 1 / found.damping) / (delay + 1 / d) - 1
                late = 1e3 * (found.delay - delay)
                print(f"{name:10} {case:8} {axis:4}{found.input / g - 1:+8.1%}{found.damping / d - 1:+9.1%}"
                      f"{late:+7.1f} ms{gain:+13.1%}{lag:+11.1%}")  # fmt: skip


if __name__ == "__main__":
    main()
