"""Simulated flights in two files: what the vehicle logged on its own clock, and what the motion capture saw."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.frames import Array, heading_from_world
from rotorfit.core.log import Log, Table
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.logs.several import join_logs
from rotorfit.simulation.paper_vehicle import SimulatedFlight

RAW: Mapping[str, Any] = {
    "command": {"time": "t", "x": "u_x", "y": "u_y", "z": "u_z", "yaw": "u_yaw"},
    "pose": {"time": "t", "x": "x", "y": "y", "z": "z", "yaw": "yaw"},
}
VELOCITY = {"frame": "heading", "time": "odometry:t", "x": "v_x", "y": "v_y", "z": "v_z", "yaw": "r"}
ATTITUDE = {"time": "odometry:t", "yaw": "psi"}


@dataclass(frozen=True)
class Sensor:
    """The vehicle's own sensors.

    Attributes:
        rate: Samples a second.
        noise: Standard deviation of the velocity [m/s]; half of it for the yaw rate [rad/s].
        heading: Of the heading [rad].
        memory: Correlation of the noise from one sample to the next.
        latency: By which a sample is stamped late [s].
    """

    rate: float = 30.0
    noise: float = 0.03
    heading: float = 0.01
    memory: float = 0.5
    latency: float = 0.0


@dataclass(frozen=True)
class Skew:
    """How the clock of the poses stands to that of the commands: offset in the middle [s], drift."""

    offset: float
    drift: float = 0.0


def card_of(*, velocity: bool = True, attitude: bool = False, **more: Any) -> Card:
    """The card of both files."""
    raw = dict(RAW) | more
    if velocity:
        raw["velocity"] = VELOCITY
    if attitude:
        raw["attitude"] = ATTITUDE
    return card_from_mapping(raw, "two files")


def in_two_files(flight: SimulatedFlight, skew: Skew, sensor: Sensor | None = None, seed: int = 0) -> tuple[Log, Log]:
    """The vehicle's log, and that of the room.

    The clock of the room starts with the flight. The vehicle's shows what makes `skew` bring it there.
    """
    sensor = sensor or Sensor()
    rng = np.random.default_rng([seed, flight.seed])
    truth = flight.pose_stamp / 1e9
    middle = float(np.mean(flight.command_stamp[[0, -1]])) / 1e9

    def by_vehicle(time: Array) -> Array:
        return middle - skew.offset + (time - middle) / (1 + skew.drift)

    time = np.arange(0.5, truth[-1] - 0.1, 1 / sensor.rate)
    time += rng.uniform(0, 0.1 / sensor.rate, time.size)
    noise = _coloured(rng, time.size, sensor.memory) * np.array([1, 1, 1, 0.5, 0]) * sensor.noise
    noise[:, 4] = (
        sensor.heading / max(sensor.noise, 1e-12) * _coloured(rng, time.size, sensor.memory)[:, 4] * sensor.noise
    )
    pose, rate = (
        np.column_stack([np.interp(time, truth, column) for column in values.T])
        for values in (flight.true_pose, flight.velocity)
    )
    seen = np.column_stack([heading_from_world(rate[:, :2], pose[:, 3]), rate[:, 2:], pose[:, 3] - 0.4]) + noise
    command = dict(zip(("u_x", "u_y", "u_z", "u_yaw"), flight.command.T, strict=True))
    sensed = dict(zip(("v_x", "v_y", "v_z", "r", "psi"), seen.T, strict=True))
    own = {
        "commands": {"t": by_vehicle(flight.command_stamp / 1e9)} | command,
        "odometry": {"t": by_vehicle(time + sensor.latency)} | sensed,
    }
    room = {"mocap": {"t": truth} | dict(zip(("x", "y", "z", "yaw"), flight.pose.T, strict=True))}
    return log_of("vehicle.bag", own), log_of("mocap.csv", room)


def as_one(flight: SimulatedFlight, skew: Skew, sensor: Sensor | None = None, seed: int = 0) -> Log:
    """Both files as one log."""
    return join_logs(in_two_files(flight, skew, sensor, seed))


def log_of(path: str, tables: Mapping[str, Mapping[str, Array]]) -> Log:
    """A log from columns."""
    named = {
        name: Table(name, {key: np.asarray(one) for key, one in columns.items()}) for name, columns in tables.items()
    }
    return Log(Path(path), "simulated", path, named, {})


def written(folder: Path, logs: Sequence[Log]) -> list[str]:
    """The tables as CSV files; their paths in order."""
    paths = []
    for log in logs:
        for name, table in log.tables.items():
            path = folder / f"{name}.csv"
            rows = np.column_stack(list(table.columns.values()))
            np.savetxt(path, rows, delimiter=",", header=",".join(table.columns), comments="", fmt="%.9f")
            paths.append(str(path))
    return paths


def _coloured(rng: np.random.Generator, count: int, memory: float) -> Array:
    noise = rng.standard_normal((count, 5))
    for k in range(1, count):
        noise[k] = memory * noise[k - 1] + np.sqrt(1 - memory**2) * noise[k]
    return noise
