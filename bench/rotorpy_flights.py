"""The same manoeuvre in rotorpy and in the virtual flight room, with the same vehicle parameters.

rotorpy is an independent simulator (Spencer Folk et al., University of Pennsylvania, MIT). Its `cmd_vel` mode takes a
world velocity and tracks it by a velocity loop, a thrust direction and an attitude loop; the heading stays at 0.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np

from rotorfit.core.flight_plan import Sines, value
from rotorfit.core.model import Axis
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.flight_room import Conditions, RoomFlight, fly_commands, log_of_room_flight
from rotorfit.simulation.sensors import Mocap
from rotorfit.simulation.vehicle import Radio, Vehicle, vehicle_from_mapping

AXES = ("x", "y", "z")
SECOND = 1_000_000_000
START = (0.0, 0.0, 2.0, 0.0)
COMMAND_RATE, POSE_RATE = 50, 100
INNER_STEP = 0.001  # s between two looks of rotorpy's inner loops at the state; ours look all the time
NOISE = 0.0005  # m
PERFECT = Mocap(rate=POSE_RATE, noise=0.0, turn_noise=0.0, latency=0.0, jitter=0.0)

CASES = {"crazyflie": 2.0, "hummingbird": 3.0}
"""Vehicle of rotorpy to the gain of its velocity loop [1/s]. rotorpy's own 10/s overshoots around either attitude loop;
these leave a first-order model its meaning."""


@dataclass(frozen=True)
class Pair:
    """One manoeuvre, flown twice.

    Attributes:
        ours: Without noise.
        theirs: Position in rotorpy at the same instants, shape (N, 3) [m].
        found: Axes of the model fitted to our log, and of that fitted to theirs; both with the same kind of noise.
    """

    ours: RoomFlight
    theirs: np.ndarray
    found: tuple[Mapping[str, Axis], Mapping[str, Axis]]


def parameters_of(name: str) -> dict[str, Any]:
    """rotorpy's parameters of a vehicle, with the gain of `CASES`."""
    parameters: dict[str, Any] = dict(import_module(f"rotorpy.vehicles.{name}_params").quad_params)
    return parameters | {"k_v": CASES[name]}


def hover_speed(parameters: Mapping[str, Any]) -> float:
    """Of a rotor [rad/s]."""
    return float(np.sqrt(parameters["mass"] * 9.81 / (4 * parameters["k_eta"])))


def vehicle_from_rotorpy(name: str) -> Vehicle:
    """A vehicle of the flight room with rotorpy's parameters, linear about hover."""
    p = parameters_of(name)
    drag = [4 * p[key] * hover_speed(p) / p["mass"] for key in ("k_d", "k_d", "k_z")]
    thrust = [p["k_eta"] * p[key] ** 2 for key in ("rotor_speed_min", "rotor_speed_max")]
    arm = float(np.linalg.norm(p["rotor_pos"]["r1"]))
    # rotorpy's inflow drag also damps roll and pitch, since a rotor that rises loses thrust: sum of k_z speed r^2
    inflow = 2 * p["k_z"] * hover_speed(p) * arm**2 / p["Ixx"]
    attitude = {"frequency": np.sqrt(p["kp_att"]), "damping": (p["kd_att"] + inflow) / (2 * np.sqrt(p["kp_att"]))}
    raw = {
        "name": f"rotorpy {name}", "mass": p["mass"], "inertia": [p["Ixx"], p["Iyy"], p["Izz"]], "drag": drag,
        "rotors": {"arm": arm, "thrust": thrust, "time_constant": p["tau_m"], "torque_ratio": p["k_m"] / p["k_eta"]},
        "attitude": {key: float(one) for key, one in attitude.items()} | {"rate_limit": 20.0, "tilt_limit": 1.0},
        "loops": {
            "velocity": p["k_v"], "climb": p["k_v"], "climb_acceleration": 5.0, "yaw": 3.0, "yaw_acceleration": 10.0,
        },
        "command": {
            "horizontal": "velocity", "unit": "si", "speed": 5.0, "vertical_speed": 5.0, "yaw_rate": 3.0,
        },
        "radio": {"latency": 0.0},
        "autopilot": {
            "brakes_on_zero": False, "command_timeout": 1.0, "land_after": float("inf"), "take_off_height": 1.0,
            "take_off_speed": 0.5, "landing_speed": 0.3,
        },
        "odometry": {"rate": 10.0, "noise": 0.0, "bias": 0.0, "yaw_noise": 0.0, "latency": 0.0},
        "battery": {"flight_time": 1e6, "sag": 0.0, "land_below": 0.0},
    }  # fmt: skip
    return vehicle_from_mapping(raw, f"rotorpy {name}")


def manoeuvre(duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [ns] and commands [m/s, rad/s]: three axes at once, four sines each, a soft start."""
    stamps = np.arange(0, round(duration * SECOND), SECOND // COMMAND_RATE)
    t = stamps * 1e-9
    waves = [
        value(Sines((0.12,) * 4, (0.5, 1.1, 1.9, 3.1), phase), t)
        for phase in ((0.0, 1, 3, 5), (2.0, 4, 1, 0), (1.0, 5, 2, 4))
    ]
    return stamps, np.stack([*waves, np.zeros(t.size)], axis=1) * np.minimum(1, t / 5)[:, None]


def fly_rotorpy(name: str, commands: np.ndarray, instants: np.ndarray, step: float = INNER_STEP) -> np.ndarray:
    """Positions of rotorpy's vehicle at instants [ns], shape (N, 3) [m]; hovers at the start."""
    from rotorpy.vehicles.multirotor import Multirotor

    parameters = parameters_of(name)
    still = {
        "x": np.array(START[:3]), "v": np.zeros(3), "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3),
        "wind": np.zeros(3), "rotor_speeds": np.full(4, hover_speed(parameters)),
    }  # fmt: skip
    vehicle = Multirotor(parameters, still, control_abstraction="cmd_vel")
    state, every = still, round(1 / (COMMAND_RATE * step))
    path = [state["x"]]
    for k in range(round(len(commands) / COMMAND_RATE / step)):
        state = vehicle.step(state, {"cmd_v": commands[k // every, :3]}, step)
        path.append(state["x"])
    return np.array(path)[np.round(instants * 1e-9 / step).astype(np.int64)]


def noisy(flight: RoomFlight, position: np.ndarray, seed: int) -> RoomFlight:
    """The flight as a mocap of `NOISE` would show these positions."""
    pose = flight.pose.copy()
    pose[:, :3] = position + NOISE * np.random.default_rng(seed).standard_normal(position.shape)
    return replace(flight, pose=pose)


def fly_both(name: str, duration: float) -> Pair:
    """Flies the manoeuvre in both simulators and identifies both (seeds of the noise: 1 and 2)."""
    vehicle, (stamps, commands) = vehicle_from_rotorpy(name), manoeuvre(duration)
    conditions = Conditions(mocap=PERFECT, radio=Radio(0.0))
    ours = fly_commands(vehicle, conditions, stamps, commands, duration, 1, START)
    theirs = fly_rotorpy(name, commands, ours.true_instant)
    card = card_from_mapping(vehicle.card(), name)
    logs = (log_of_room_flight(noisy(ours, path, seed)) for seed, path in ((1, ours.true_position), (2, theirs)))
    first, second = (
        fit([flight_from_log(log, card)], axes=AXES, structure="first_order_delay").model.axes for log in logs
    )
    return Pair(ours, theirs, (first, second))


def step_gap(name: str, step: float) -> float:
    """Largest gap between the two paths over 2 s after a step of 0.05 m/s forward, over the distance flown."""
    stamps = np.arange(0, 2 * SECOND, SECOND // COMMAND_RATE)
    commands = np.tile([0.05, 0.0, 0.0, 0.0], (stamps.size, 1))
    room = Conditions(mocap=PERFECT, radio=Radio(0.0))
    ours = fly_commands(vehicle_from_rotorpy(name), room, stamps, commands, 2.0, 1, START)
    theirs = fly_rotorpy(name, commands, ours.true_instant, step)
    return float(np.abs(theirs - ours.true_position)[:, 0].max() / np.ptp(theirs[:, 0]))
