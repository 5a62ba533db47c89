"""Links: what carries commands to a vehicle and its pose back. `open_link("name:address", card) -> Link`.

A link is three methods and a clock. `fly` knows nothing else of a vehicle, so a simulated flight, a replayed log and a
real drone go through the same code. Each kind of link is a module with `open_link(address, card)`,
imported when it is asked for.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from types import MappingProxyType

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.flight_plan import Four
from rotorfit.flying.links.link import Action, Link
from rotorfit.flying.links.poses_apart import join

__all__ = ["INSTALL", "LINKS", "Action", "Link", "open_link"]

LINKS: Mapping[str, str] = MappingProxyType(
    {
        "sim": "rotorfit.flying.links.sim",
        "replay": "rotorfit.flying.links.replay",
        "ros1": "rotorfit.flying.links.ros1",
        "ros2": "rotorfit.flying.links.ros2",
        "mavlink": "rotorfit.flying.links.mavlink",
        "tello": "rotorfit.flying.links.tello",
    }
)
"""Name of a link to the module that opens it."""

INSTALL: Mapping[str, str] = MappingProxyType(
    {
        "ros1": "run in a shell of a ROS 1 installation "
        "(Debian: apt install python3-rospy python3-geometry-msgs python3-nav-msgs python3-std-msgs)",
        "ros2": "run in a shell of a ROS 2 installation: source /opt/ros/DISTRO/setup.bash",
        "mavlink": "pip install 'rotorfit[mavlink]'",
    }
)
"""How to get what a link needs beyond rotorfit itself."""


def open_link(
    text: str,
    card: Card,
    start: Four = (0.0, 0.0, 1.5, 0.0),
    seed: int = 0,
    flying: bool = True,
    poses: str = "",
) -> Link:
    """Opens a link.

    Args:
        text: `NAME`, `NAME:ADDRESS` or `NAME,OPTION=VALUE`; what an address is, each link says.
        card: Meaning and unit of the commands; for links that carry named messages, also which.
        start: Where a simulated vehicle is: x, y, z [m] and yaw [rad].
        seed: Of a simulated vehicle.
        flying: Whether a simulated vehicle is in the air already.
        poses: `NAME:ADDRESS` of another link that gives the poses; empty for the vehicle's own.

    Raises:
        LinkError: No such link, something to install is missing, or nobody answers.
    """
    name = re.split("[:,]", text, maxsplit=1)[0]  # options may follow the name itself: `sim,wind=2`
    address = text[len(name) :].removeprefix(":")
    if name not in LINKS:
        raise LinkError(f"--link {text}: no link {name!r}; links are {', '.join(LINKS)}")
    with _told_to_install(name):
        module = import_module(LINKS[name])
        link: Link = module.open_link(address, card, *((start, seed, flying) if name == "sim" else ()))
    if not poses:
        return link
    try:
        with _told_to_install(poses.partition(":")[0]):
            return join(link, poses)
    except LinkError:
        link.act("close")
        raise


@contextmanager
def _told_to_install(name: str) -> Iterator[None]:
    """A package that is missing is one line that says how to get it."""
    try:
        yield
    except ModuleNotFoundError as error:
        remedy = INSTALL.get(name, f"pip install {error.name}")
        raise LinkError(f"link {name} needs the Python package {error.name}: {remedy}") from error
