"""Views: the live page, the Foxglove server and ROS topics, while a vehicle is tracked."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Any

from rotorfit.app.live.outlets import Moving, Outlet
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Tracked


class Views:
    """The requested views as one outlet.

    Args:
        page: Port of the live page, 0 for any free one; None for no page.
        foxglove: Port of the Foxglove server, 0 for any free one; None for no server.
        publish: `ros1` or `ros2`, optionally with a prefix; None for no topics.
        vehicle: Name of the tracked vehicle for the user.
        say: Called with a line that has the address of each.

    Attributes:
        moving: Functions that take the motion after each pose.
    """

    def __init__(
        self, page: int | None, foxglove: int | None, publish: str | None, vehicle: str, say: Callable[[str], None]
    ) -> None:
        self._asked, self._vehicle, self._say = (page, foxglove, publish), vehicle, say
        self._outlets: list[Outlet] = []
        self.moving: list[Moving] = []
        self._stack = ExitStack()

    def __enter__(self) -> "Views":
        page, foxglove, publish = self._asked
        with ExitStack() as stack:
            if page is not None:
                from rotorfit.app.live.page_server import LivePage

                self._add(stack, LivePage(page, self._vehicle, self._say))
            if foxglove is not None:
                from rotorfit.app.live.foxglove import FoxgloveOutlet

                server = FoxgloveOutlet(foxglove, self._say)
                self._add(stack, server)
                self.moving.append(server.motion)
            if publish is not None:
                from rotorfit.app.live.ros_topics import RosTopics

                self._add(stack, RosTopics(publish, self._vehicle))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _add(self, stack: ExitStack, outlet: Outlet) -> None:
        self._outlets.append(outlet)
        stack.callback(outlet.close)

    def heard(self, samples: Sequence[Sample], now: int) -> None:
        """Passes samples on."""
        for outlet in self._outlets:
            outlet.heard(samples, now)

    def state(self, state: Tracked, now: int, held: int) -> None:
        """Passes a state on."""
        for outlet in self._outlets:
            outlet.state(state, now, held)

    def gains(self, message: Mapping[str, Any], now: int) -> None:
        """Passes new gains on."""
        for outlet in self._outlets:
            outlet.gains(message, now)

    def close(self) -> None:
        """Does nothing: the views stay open until the result has been shown."""
