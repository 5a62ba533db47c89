"""Clean flights of many vehicles: what no finding may fire on, but `feedback` where the loop is closed."""

from collections.abc import Iterator
from functools import cache, lru_cache

import numpy as np

from flights import CARD, steps
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.log import Log
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import STABLE, Controller, Truth, as_log, simulate_flight

VEHICLES = tuple(STABLE.values())
ACCELERATION = np.array([0.8, 0.8, 0.8, 1.2])
"""What the steps ask for [m/s^2, rad/s^2]: well excited, whatever the vehicle; commands stay within full scale."""


def clean_flights(seeds: range) -> Iterator[tuple[int, bool, Log, Flight]]:
    """One flight a seed: a published vehicle, 40 to 90 s of random steps on two to four axes, light wind.

    Every other one holds its place by feedback from the measured pose.
    """
    for seed in seeds:
        yield seed, *_flown(seed)


@cache
def clean_fit(seed: int) -> Fit:
    """The fit of one of them under the law that it flew."""
    return fit([_flown(seed)[-1]], structure="first_order_delay")


@lru_cache(64)
def _flown(seed: int) -> tuple[bool, Log, Flight]:
    rng = np.random.default_rng(1000 + seed)
    gamma = VEHICLES[seed % len(VEHICLES)]
    truth = Truth(
        gamma=gamma,
        delay=tuple(rng.uniform(0.0, 0.3, 4)),
        trim=(*rng.uniform(-0.03, 0.03, 3), 0.0),
        wind_sigma=(*(rng.uniform(0.005, 0.05),) * 3, rng.uniform(0.002, 0.02)),
        wind_time=(rng.uniform(0.5, 2.0),) * 4,
        mocap_noise=(*(10 ** rng.uniform(-4, np.log10(0.002)),) * 3, 10 ** rng.uniform(-3.5, -2.3)),
        stale_share=rng.uniform(0.0, 0.03),
        pose_rate=float(rng.choice([60.0, 100.0, 120.0])),
        command_rate=float(rng.choice([20.0, 30.0, 50.0])),
    )
    closed = bool(seed % 2)  # then all axes are excited: the loop alone excites nothing
    axes = AXES if closed else (("x", "y"), ("x", "y", "yaw"), ("z", "yaw"), AXES)[int(rng.integers(4))]
    controller = Controller(0.5, 0.8) if closed else None
    amplitude = np.minimum(ACCELERATION / np.array(gamma[::2]), 1.0)
    every = rng.uniform(0.6, 1.2)
    excitation = steps(axes, amplitude, seed, every)
    simulated = simulate_flight(
        truth, excitation, float(rng.uniform(40, 90)), seed, controller=controller, initial_yaw=rng.uniform(-3, 3)
    )
    log = as_log(simulated)
    return closed, log, flight_from_log(log, CARD)
