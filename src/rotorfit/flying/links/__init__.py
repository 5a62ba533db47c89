"""Links carry commands to a vehicle and its pose back. `links.opening.open_link("NAME:ADDRESS", card) -> Link`.

A link is three methods and a clock. `fly` knows nothing else of a vehicle, so a simulated flight, a replayed log and a
real drone run through the same code. A new link is a module with `open_link(address, card) -> Link` and one row here.
This module imports nothing heavy, so that `rotorfit --help` can read it.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class LinkKind:
    """A kind of link.

    Attributes:
        usage: What follows `--link`, for a list of links.
        module: Module that opens it, imported on demand.
        install: How to install what it needs beyond rotorfit itself.
        poses: Whether it can provide poses alone, by `open_poses(address)`.
        example: An example, if the address is required; otherwise empty.
        simulated: Whether its vehicle starts where the address says, see `simulated_at`.
        listens: Module that follows a vehicle flown by somebody else, by `open_listener(address, card)`; empty if that
            is impossible.
        alone: Why it is impossible.
    """

    usage: str
    module: str
    install: str = ""
    poses: bool = False
    example: str = ""
    simulated: bool = False
    listens: str = ""
    alone: str = "it has no listener"


_LINKS = "rotorfit.flying.links"

LINKS: Mapping[str, LinkKind] = {
    "sim": LinkKind(
        "sim:VEHICLE,wind=1,gusts=0.3 [m/s]", f"{_LINKS}.sim", simulated=True, listens=f"{_LINKS}.sim_pilot"
    ),
    "replay": LinkKind("replay:FILE", f"{_LINKS}.replay", example="replay:flight.mcap", listens=f"{_LINKS}.replay"),
    "ros1": LinkKind(
        "ros1",
        f"{_LINKS}.ros1",
        "run in a shell of a ROS 1 installation "
        "(Debian: apt install python3-rospy python3-geometry-msgs python3-nav-msgs python3-std-msgs)",
        poses=True,
        listens=f"{_LINKS}.ros1",
    ),
    "ros2": LinkKind(
        "ros2",
        f"{_LINKS}.ros2",
        "run in a shell of a ROS 2 installation: source /opt/ros/DISTRO/setup.bash",
        poses=True,
        listens=f"{_LINKS}.ros2",
    ),
    "mavlink": LinkKind(
        "mavlink:ADDRESS",
        f"{_LINKS}.mavlink",
        "pip install 'rotorfit[mavlink]'",
        poses=True,
        listens=f"{_LINKS}.mavlink_listener",
    ),
    "tello": LinkKind(
        "tello:HOST",
        f"{_LINKS}.tello",
        alone="a Tello talks to one controller alone, and its sticks are heard by nobody else; "
        "fly it with `rotorfit fly --track`",
    ),
}
"""Every link by its name."""
