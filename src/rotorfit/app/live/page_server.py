"""The live page of `rotorfit track --page`: states as they come, on 127.0.0.1, behind the studio's gate."""

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Tracked


class LivePage:
    """Serves the page from a thread of its own.

    Args:
        port: Port to listen on; 0 for any free one.
        vehicle: Name of the tracked vehicle for the user.
        say: Called with a line that has the address, including the key of this run.

    Raises:
        LinkError: The studio's server is not installed, or the port is taken.
    """

    def __init__(self, port: int, vehicle: str, say: Callable[[str], None]) -> None:
        try:
            from starlette.applications import Starlette

            from rotorfit.app.live.feed import Feed, live_routes
            from rotorfit.app.loopback.listener import Loopback
        except ModuleNotFoundError:
            raise LinkError("--page needs the studio's server: pip install 'rotorfit[studio]'") from None
        try:
            self._loopback = Loopback(port, "track")
        except OSError as error:
            raise LinkError(f"--page {port}: {error.strerror}; choose another port, or none") from None
        self._feed = feed = Feed(vehicle)
        app = self._loopback.gated(Starlette(routes=live_routes(lambda: feed)))
        self._server = self._loopback.server(app, 1)
        sockets = {"sockets": [self._loopback.socket]}
        self._thread = threading.Thread(target=self._server.run, kwargs=sockets, name="rotorfit-page", daemon=True)
        self._thread.start()
        say(f"live page: {self._loopback.address}")

    def heard(self, _samples: Sequence[Sample], _now: int) -> None:
        """Does nothing: pages show states only."""

    def state(self, state: Tracked, _now: int, _held: int) -> None:
        """Shows a state and its alarms."""
        for alarm in state.alarms:
            self._feed.add(alarm.to_mapping())
        self._feed.add(state.to_mapping())

    def gains(self, message: Mapping[str, Any], _now: int) -> None:
        """Shows new gains."""
        self._feed.add(dict(message))

    def close(self) -> None:
        """Ends the server; open pages say so."""
        self._feed.over = True
        self._server.should_exit = True
        self._thread.join(5.0)
        self._loopback.socket.close()
