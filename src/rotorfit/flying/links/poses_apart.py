"""Two links as one: commands over the first, poses over the second, for vehicles that do not know their position."""

from collections.abc import Sequence
from importlib import import_module

from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.flying.links import LINKS
from rotorfit.flying.links.link import Action, Link, Silence


def join(commands: Link, text: str) -> Link:
    """Takes the poses from another link.

    Args:
        commands: A live link; its own poses are dropped, its velocity and battery stay.
        text: `NAME:ADDRESS` of the other: the topic of `ros1` and `ros2`, the port of `mavlink`.

    Raises:
        LinkError: There is no such link, it cannot be opened, or the first is simulated. The first link is left open.
        ModuleNotFoundError: A package that the other needs is missing.
    """
    name, _, address = text.partition(":")
    sources = [kind for kind, link in LINKS.items() if link.poses]
    if name not in sources:
        raise LinkError(f"--poses {text}: poses come from {', '.join(sources)}, as in ros1:/vicon/tello/tello")
    if not commands.live:
        raise LinkError(f"--poses {text}: a simulated vehicle has its own poses; leave --poses out")
    poses: Link = import_module(LINKS[name].module).open_poses(address)
    return Joined(commands, poses)


class Joined:
    """Commands over one link, poses over another; implements `Link`. Both use the wall clock of this process."""

    def __init__(self, commands: Link, poses: Link) -> None:
        self.live = True
        self._commands = commands
        self._poses = poses

    @property
    def now(self) -> int:
        """The wall clock [ns]."""
        return self._commands.now

    @property
    def fail_safe(self) -> str:
        """That of the first link."""
        return self._commands.fail_safe

    @property
    def undone(self) -> str:
        """That of the first link."""
        return self._commands.undone

    @property
    def silence(self) -> Silence:
        """That of the first link, which may learn it from the vehicle later."""
        return self._commands.silence

    def send(self, command: Sequence[float]) -> Sequence[float]:
        """Sends over the first link."""
        return self._commands.send(command)

    def receive(self, until: int) -> list[Sample]:
        """Poses of the second link and what it says, everything else of the first, in the order of arrival."""
        poses = [sample for sample in self._poses.receive(until) if sample.stream in ("pose", "said")]
        rest = [sample for sample in self._commands.receive(until) if sample.stream != "pose"]
        return sorted(poses + rest, key=lambda sample: sample.received)

    def act(self, action: Action) -> None:
        """Acts over the first link; `close` closes both."""
        try:
            self._commands.act(action)
        finally:
            if action == "close":
                self._poses.act(action)
