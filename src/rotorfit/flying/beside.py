"""A tracker beside a flight of ours, in a process of its own, fed with what the flight loop sends and receives.

The loop writes to a non-blocking socket; samples that the other process cannot take in time are dropped and counted.
Alarms come back and are recorded as events. Nothing of this reaches the vehicle.
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
from contextlib import contextmanager, suppress
from typing import Any

from rotorfit.core.log import Sample
from rotorfit.core.tracked import Tracked
from rotorfit.files.cards import card_from_mapping

RECORD = struct.Struct("<Bqq7d")
"""Stream number, stamp [ns], arrival [ns], and seven values, as many as a pose has."""

STREAMS = ("pose", "command")

WIDTH = {"pose": 7, "command": 4}

ROOM = 1 << 20
"""Bytes that may wait for the other process: a minute of samples, while it starts."""

NICE = 10
"""Niceness of the other process."""

PATIENCE = 30.0
"""How long the other process may take to end before it is killed [s]."""


class Beside:
    """The near end: takes samples without ever waiting.

    Args:
        card: Raw card of the commands that are flown.

    Attributes:
        words: The state of each axis, in words; empty before the first look.
        alarm: Axes and cause of the last alarm; empty before any.
        lost: Number of samples that the other process could not take in time.
    """

    def __init__(self, card: Mapping[str, Any]) -> None:
        self.words, self.alarm, self.lost = "", "", 0
        near, far = socket.socketpair()
        words = [sys.executable, "-m", "rotorfit.flying.beside"]
        quiet = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            words, stdin=far.fileno(), stdout=subprocess.PIPE, env={**os.environ, **quiet}, start_new_session=True
        )
        far.close()
        self._near, self._rest = near, bytearray()
        near.sendall(json.dumps(card).encode() + b"\n")
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
        """The alarms since the last call."""
        while self._news:
            yield self._news.popleft()

    def close(self) -> None:
        """Ends the other process after its last look; its last alarms are then in `news`."""
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
            self.words = told["words"]
            self._news.extend(told["alarms"])
            self.alarm = title_of(told["alarms"][-1]) if told["alarms"] else self.alarm


@contextmanager
def tracked_beside(card: Mapping[str, Any], wanted: bool) -> Iterator[Beside | None]:
    """A tracker beside a flight, if `wanted`, else None; it is closed on exit."""
    if not wanted:
        yield None
        return
    beside = Beside(card)
    try:
        yield beside
    finally:
        beside.close()


def title_of(alarm: str) -> str:
    """An alarm without its reasons, which may have colons of their own: `ALARM z: payload`."""
    return ": ".join(alarm.split(": ")[:2])


def words_of(state: Tracked) -> str:
    """The state of each axis, in a few words."""
    return ", ".join(f"{name} {axis.state.partition(' (')[0]}" for name, axis in state.axes.items())


def main() -> None:
    """The far end: reads samples from standard input, writes words and alarms to standard output."""
    from rotorfit.tracking.tracker import Tracker

    os.nice(NICE)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no answer
    stream = sys.stdin.buffer
    tracker = Tracker(card_from_mapping(json.loads(stream.readline()), "of the flight"))
    last = tracker.state()

    def tell(state: Tracked) -> None:
        alarms = [f"ALARM {', '.join(one.axes)}: {one.cause}: {one.why}" for one in state.alarms]
        print(json.dumps({"words": words_of(state), "alarms": alarms}), file=answers, flush=True)

    while len(data := stream.read(RECORD.size)) == RECORD.size:
        number, stamp, received, *values = RECORD.unpack(data)
        name = STREAMS[number]
        tracker.update(Sample(name, stamp, received, tuple(values[: WIDTH[name]])))  # type: ignore[arg-type]
        if tracker.state() is not last:
            last = tracker.state()
            tell(last)


if __name__ == "__main__":
    main()
