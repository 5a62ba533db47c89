"""A tracker beside a flight of ours, in a process of its own, fed with what the flight loop sends and receives.

The loop writes to a non-blocking socket; samples that the other process cannot take in time are dropped and counted.
Alarms and gains come back and are recorded as events. Nothing of this reaches the vehicle.
"""

import json
import os
import socket
import struct
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

RECORD = struct.Struct("<Bqq7d")
"""Stream number, stamp [ns], arrival [ns], and seven values, as many as a pose has."""

STREAMS = ("pose", "command")

WIDTH = {"pose": 7, "command": 4}

ROOM = 1 << 20
"""Bytes that may wait for the other process: a minute of samples, while it starts."""

PATIENCE = 30.0
"""How long the other process may take to end before it is killed [s]."""


class Beside:
    """The near end: takes samples without ever waiting.

    Args:
        program: Module that is the far end.
        asked: What it is told first; as plain types.

    Attributes:
        words: The state of each axis, in words; empty before the first look.
        alarm: Axes and cause of the last alarm; empty before any.
        summary: What the other process said at its end.
        lost: Number of samples that the other process could not take in time.
    """

    def __init__(self, program: str, asked: Mapping[str, Any]) -> None:
        self.words, self.alarm, self.summary, self.lost = "", "", "", 0
        near, far = socket.socketpair()
        words = [sys.executable, "-m", program]
        quiet = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            words, stdin=far.fileno(), stdout=subprocess.PIPE, env={**os.environ, **quiet}, start_new_session=True
        )
        far.close()
        self._near, self._rest = near, bytearray()
        near.sendall(json.dumps(asked).encode() + b"\n")
        near.setblocking(False)
        self._news: deque[str] = deque()
        self._thread = threading.Thread(target=self._run, name="rotorfit-beside", daemon=True)
        self._thread.start()

    def take(self, stream: str, stamp: int, received: int, values: Sequence[float]) -> None:
        """Hands over a sample.

        Args:
            stream: `pose` or `command`.
            stamp: By the sender's clock [ns].
            received: Time of arrival [ns].
            values: Of the pose or the command, as in a `Sample`.
        """
        padded = (*values, 0.0, 0.0, 0.0) if stream == "command" else values
        if len(self._rest) > ROOM:
            self.lost += 1
        else:
            self._rest += RECORD.pack(STREAMS.index(stream), stamp, received, *padded)
        try:
            del self._rest[: self._near.send(self._rest)]
        except OSError:  # the socket is full, or the other process is gone
            return

    def news(self) -> Iterator[str]:
        """The alarms and gains since the last call."""
        while self._news:
            yield self._news.popleft()

    def close(self) -> None:
        """Ends the other process after its last look; its last words are then in `news`."""
        self._near.settimeout(PATIENCE)
        with suppress(OSError):
            self._near.sendall(self._rest)
        self._near.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join(1.0)

    def _run(self) -> None:
        """Body of the thread that reads from the other process."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            told = json.loads(line)
            self.words, self.summary = told["words"], told["summary"]
            self._news.extend([*told["alarms"], *told["gains"]])
            self.alarm = title_of(told["alarms"][-1]) if told["alarms"] else self.alarm


def title_of(alarm: str) -> str:
    """An alarm without its reasons, which may have colons of their own: `ALARM z: payload`."""
    return ": ".join(alarm.split(": ")[:2])
