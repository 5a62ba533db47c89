"""Simulated flights with the vehicle's own velocity beside the pose or in its place, as logs."""

from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import heading_from_world
from rotorfit.core.log import Log, Table
from rotorfit.files.cards import builtin_cards, card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import LOG_EPOCH, SimulatedFlight, as_log

COLUMNS = {
    "x": "/odom:twist.linear.x",
    "y": "/odom:twist.linear.y",
    "z": "/odom:twist.linear.z",
    "yaw": "/odom:twist.angular.z",
}


def onboard_card(alone: tuple[str, ...] = ("x", "y", "z"), independent: bool = False, frame: str = "heading") -> Card:
    """The demo's card without the positions of some axes, and with a [velocity]."""
    raw: dict[str, Any] = dict(builtin_cards()["rotorfit-demo"].raw)
    raw["pose"] = {key: value for key, value in raw["pose"].items() if key not in alone}
    velocity: dict[str, Any] = {"frame": frame, "time": "/odom:header.stamp", **COLUMNS}
    if independent:
        velocity["independent"] = True
    return card_from_mapping({**raw, "velocity": velocity}, "onboard")


def with_odometry(
    flown: SimulatedFlight,
    rate: float = 20.0,
    noise: float = 0.03,
    bias: float = 0.01,
    latency: float = 0.06,
    rounding: float = 0.0,
    frame: str = "heading",
) -> Log:
    """The flight's log with a table /odom: the true velocity of every few poses, late, biased, noisy, rounded."""
    every = round(flown.truth.pose_rate / rate)
    at = np.arange(every, flown.pose_stamp.size, every)
    value = flown.velocity[at].copy()
    if frame == "heading":
        value[:, :2] = heading_from_world(value[:, :2], flown.true_pose[at, 3])
    value += bias + noise * np.random.default_rng([flown.seed, 1]).standard_normal(value.shape)
    if rounding:
        value = rounding * np.round(value / rounding)
    stamp = LOG_EPOCH + flown.pose_stamp[at] + round(latency * 1e9)
    columns = {name.split(":")[1]: column for name, column in zip(COLUMNS.values(), value.T, strict=True)}
    log = as_log(flown)
    return replace(log, tables={**log.tables, "/odom": Table("/odom", {"header.stamp": stamp, **columns})})


def read_back(log: Log, card: Card) -> Flight:
    """The flight that a log and a card make."""
    return flight_from_log(log, card)
