"""A Foxglove WebSocket server, which Foxglove and PlotJuggler (3.17 and later) read. Needs foxglove-sdk."""

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

from rotorfit.app.live.outlets import ALARM, GAINS, MOTION, TRACKED
from rotorfit.core.errors import LinkError
from rotorfit.core.frames import AXES
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Motion, Tracked

POSE, COMMAND = "/rotorfit/pose", "/rotorfit/command"

HOST = "127.0.0.1"

OBJECT = {"type": "object"}

PATIENCE = 2.0
"""How long clients may take to read what is left [s]."""


class FoxgloveOutlet:
    """Serves poses, commands, states, alarms, new gains and the motion after each pose as JSON.

    Args:
        port: Port to listen on; 0 for any free one.
        say: Called with a line that has the address.

    Raises:
        LinkError: foxglove-sdk is missing, or the port is taken.
    """

    def __init__(self, port: int, say: Callable[[str], None]) -> None:
        try:
            foxglove = import_module("foxglove")
        except ModuleNotFoundError:
            raise LinkError(
                "--foxglove needs the Python package foxglove-sdk: pip install 'rotorfit[foxglove]'"
            ) from None
        self._context = context = foxglove.Context()  # channels close with it
        try:
            self._server: Any = foxglove.start_server(name="rotorfit track", host=HOST, port=port, context=context)
        except (OSError, RuntimeError) as error:
            raise LinkError(f"--foxglove {port}: {error}; choose another port") from None
        self._channels = {
            topic: foxglove.Channel(topic, schema=OBJECT, message_encoding="json", context=context)
            for topic in (POSE, COMMAND, TRACKED, ALARM, GAINS, MOTION)
        }
        self.port = int(self._server.port)
        say(f"Foxglove and PlotJuggler: ws://{HOST}:{self.port}")

    def heard(self, samples: Sequence[Sample], _now: int) -> None:
        """Sends poses and commands."""
        for sample in samples:
            if not all(map(math.isfinite, sample.values)):
                continue
            if sample.stream == "pose":
                names: Sequence[str] = ("x", "y", "z", "qw", "qx", "qy", "qz")
                self._send(POSE, dict(zip(names, sample.values, strict=True)), sample.received)
            elif sample.stream == "command":
                self._send(COMMAND, dict(zip(AXES, sample.values, strict=True)), sample.received)

    def state(self, state: Tracked, now: int, _held: int) -> None:
        """Sends a state and its alarms."""
        for alarm in state.alarms:
            self._send(ALARM, alarm.to_mapping(), now)
        self._send(TRACKED, state.to_mapping(), now)

    def gains(self, message: Mapping[str, Any], now: int) -> None:
        """Sends new gains."""
        self._send(GAINS, message, now)

    def motion(self, motion: Motion, now: int) -> None:
        """Sends the motion after a pose."""
        self._send(MOTION, motion.to_mapping(), now)

    def close(self) -> None:
        """Ends the server; `stop` would wait for a client that takes nothing any more."""
        thread = threading.Thread(target=self._server.stop, name="rotorfit-foxglove", daemon=True)
        thread.start()
        thread.join(PATIENCE)

    def _send(self, topic: str, mapping: Mapping[str, Any], stamp: int) -> None:
        self._channels[topic].log(dict(mapping), log_time=stamp)
