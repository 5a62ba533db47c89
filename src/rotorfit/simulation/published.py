"""Published coefficients of commercial quadrotors: for comparison, as priors, and as truths to simulate.

gamma as published, signs included: input and damping of x, y, z, yaw in turn, of a = input u - damping v.
No source of a set in fractions states its limits, so these gains compare only in units of the command;
`limit_that_gives` returns the limit to which they correspond.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class PublishedSet:
    """One published set of coefficients.

    Attributes:
        name: Short name, as in the documents.
        vehicle: A name that `vehicle_of` returns.
        command: `fraction` of limits that are not published, or `si`: rad, rad, m/s, rad/s.
        gamma: Shape (8,), None where nothing was published [m/s^2 or rad/s^2 per unit of command; 1/s].
        delay: Delay [s]; None where the source has none.
        source: Author, and how the pose was measured.
    """

    name: str
    vehicle: str
    command: Literal["fraction", "si"]
    gamma: tuple[float | None, ...]
    delay: float | None
    source: str


_DRONE_DEV = "configuration of jrsbenevides/drone_dev"

_NERO = "public controllers of the NERO group (UFV/UFES)"

PUBLISHED: tuple[PublishedSet, ...] = (
    PublishedSet(
        "paper", "Bebop 2", "fraction", (4.33, 0.23, 4.12, 0.41, 4.42, 3.13, 5.92, -0.38), None,
        "Santos et al., Parameter Estimation Based on Linear Regression for Commercial Quadrotors, section 5; Vicon",
    ),
    PublishedSet(
        "A", "Bebop 2", "fraction", (1.7420, 0.9402, 1.5441, 0.8963, 3.3489, 3.2947, 6.5121, 3.9219), None,
        f"{_DRONE_DEV}; onboard odometry",
    ),
    PublishedSet(
        "B", "Bebop 2", "fraction", (3.6976, 0.1832, 3.8513, 0.3573, 2.4596, 2.1683, 4.4168, 2.7023), None,
        f"{_DRONE_DEV}; Vicon, 2019-09-18",
    ),
    PublishedSet(
        "C", "Bebop 2", "fraction", (4.5752, 0.1149, 5.2296, 0.2364, 4.4206, 3.1341, 5.9289, -0.3868), None,
        f"{_DRONE_DEV}; Vicon, 2018-10-15",
    ),
    PublishedSet(
        "E", "Bebop 2", "fraction", (0.8417, 0.18227, 0.8354, 0.17095, 3.966, 4.001, 9.8524, 4.7295), None, _NERO,
    ),
    PublishedSet(
        "F", "AR.Drone 2", "fraction", (14.72, 0.2766, 6.233, 0.53, 2.6504, 2.576, 0.3788, 1.5216), None, _NERO,
    ),
    PublishedSet(
        "G", "Bebop 2", "si", (-5.4779, 0.0527, -7.0608, 0.0187, -1.7382, 1.7873, None, None), None,
        "Amiri and Hosseinzadeh, arXiv 2404.07267; OptiTrack",
    ),
    PublishedSet(
        "H", "Bebop 1", "si", (9.81, 0.5763, 9.81, 0.5850, None, None, None, None), 0.262137,
        "configuration of AutonomyLab/bebop_vel_ctrl; onboard odometry",
    ),
)  # fmt: skip

_KIN: Mapping[str, tuple[str, ...]] = {
    "Bebop 2": ("Bebop 2", "Bebop 1"),
    "Bebop 1": ("Bebop 1", "Bebop 2"),
    "AR.Drone 2": ("AR.Drone 2",),
}
"""Vehicles whose sets are comparable with a vehicle's own."""

_NAMED = (
    ("Bebop 2", r"bebop[\s_-]*2\b"),
    ("Bebop 1", r"bebop\b"),
    ("AR.Drone 2", r"ar[\s._-]*drone[\s_-]*2\b"),
)


def vehicle_of(name: str) -> str | None:
    """`Bebop 2`, `Bebop 1` or `AR.Drone 2` if a card's name contains it, else None."""
    return next((vehicle for vehicle, pattern in _NAMED if re.search(pattern, name, re.IGNORECASE)), None)


def sets_for(vehicle: str) -> tuple[PublishedSet, ...]:
    """The published sets of a vehicle and its closest relatives; empty for an unknown vehicle."""
    return tuple(known for known in PUBLISHED if known.vehicle in _KIN.get(vehicle, ()))
