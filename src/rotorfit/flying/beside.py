"""A tracker beside a flight of ours, in a process of its own, fed with what the flight loop sends and receives.

The loop writes to a non-blocking socket; samples that the other process cannot take in time are dropped and counted.
Where time is simulated (paced), the loop waits instead. Alarms and gains come back and are recorded as events. Nothing
of this reaches the vehicle.
"""

import json
import os
import socket
import struct
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, Literal

from rotorfit.core.log import NUMBERS, Sample

RECORD = struct.Struct("<Bqq8d")
"""Stream number, stamp [ns], arrival [ns], error of the stamp [s], and seven values, as many as a pose has."""

STREAMS: tuple[Literal["pose", "command", "obeys"], ...] = ("pose", "command", "obeys")
"""Streams that a tracker beside needs."""

ROOM = 1 << 20
"""Bytes that may wait for the other process: a minute of samples, while it starts."""

PATIENCE = 120.0
"""How long the other process may take to catch up and fit the flight once more before it is killed [s]."""


class Beside:
    """The near end: takes samples, without ever waiting unless it is paced.

    Args:
        program: Module that is the far end.
        asked: What it is told first; as plain types.
        paced: Whether to wait for the other process: simulated time can.

    Attributes:
        time: That of the last look, in seconds of the flight.
        words: The state of each axis then, in words; empty before the first look.
        alarm: Axes and cause of the last alarm; empty before any.
        told: All alarms and gains so far, in words, each alarm as it was revised last.
        summary: What the other process said at its end; empty if it was ended before.
        lost: Number of samples that the other process could not take in time.
    """

    def __init__(self, program: str, asked: Mapping[str, Any], paced: bool = False) -> None:
        self.time, self.words, self.alarm, self.summary, self.lost = 0.0, "", "", "", 0
        self._paced = paced
        near, far = socket.socketpair()
        words = [sys.executable, "-m", program]
        quiet = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            words, stdin=far.fileno(), stdout=subprocess.PIPE, env={**os.environ, **quiet}, start_new_session=True
        )
        far.close()
        self._near, self._rest = near, bytearray()
        near.sendall(json.dumps(asked).encode() + b"\n")
        near.setblocking(paced)
        self.told: list[str] = []
        self._news: deque[str] = deque()
        self._thread = threading.Thread(target=self._run, name="rotorfit-beside", daemon=True)
        self._thread.start()

    def take(self, sample: Sample) -> None:
        """Hands over a pose, a command, or whether the vehicle obeys."""
        if len(self._rest) > ROOM:
            self.lost += 1
        else:
            number = STREAMS.index(sample.stream)
            padding = (0.0,) * (NUMBERS["pose"] - len(sample.values))
            self._rest += RECORD.pack(number, sample.stamp, sample.received, sample.error, *sample.values, *padding)
        with suppress(OSError):  # the socket is full, or the other process is gone
            del self._rest[: self._near.send(self._rest)]

    def news(self) -> Iterator[str]:
        """The alarms and gains since the last call."""
        while self._news:
            yield self._news.popleft()

    def close(self) -> None:
        """Ends the other process after its last fit, or at Ctrl-C; its last words are then in `news` and `summary`."""
        patience = None if self._paced else PATIENCE
        self._near.settimeout(patience)
        try:
            with suppress(OSError):
                self._near.sendall(self._rest)
            self._near.close()
            self._process.wait(patience)
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            self._process.kill()
            self._process.wait()
        self._thread.join(1.0)

    def _run(self) -> None:
        """Body of the thread that reads from the other process."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            told = json.loads(line)
            self.time, self.words, self.summary = told["time"], told["words"], told["summary"]
            for text, revised in (*told["alarms"], *((line, None) for line in told["lines"])):
                place = self.told.index(revised) if revised in self.told else len(self.told)
                self.told[place : place + 1] = [text]
                self._news.append(text)
            self.alarm = title_of(told["alarms"][-1][0]) if told["alarms"] else self.alarm


def title_of(alarm: str) -> str:
    """An alarm without its reasons, which may have colons of their own: `41.0 s  ALARM z: payload`."""
    return ": ".join(alarm.split(": ")[:2])
