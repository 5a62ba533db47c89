"""A tracker beside a flight of ours, in a process of its own: it is told what the flight loop sends and receives.

The loop writes a few bytes into a socket that never makes it wait; what the other process cannot take in time is left
out and counted. Alarms come back and go into the recording as events. Nothing of it reaches the vehicle.
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
"""Stream, stamp, arrival, and as many numbers as a pose has."""

STREAMS = ("pose", "command")

WIDTH = {"pose": 7, "command": 4}

ROOM = 1 << 20
"""Bytes that may wait for the other process: a minute of samples, while it loads what it needs."""

NICE = 10
"""The other process stands back by so much."""

PATIENCE = 30.0
"""How long it may take to end [s]."""


class Beside:
    """The near end: takes samples without ever waiting.

    Args:
        card: Raw, of the commands that are flown.

    Attributes:
        words: What is known of each axis, in words; empty before the first look.
        alarm: The last; empty before any.
        lost: Samples that the other process could not take in time.
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
        """Hands over a pose or a command [ns]."""
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
        """Ends the other process after its last look; its last alarms are among the news."""
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
        """The thread that hears the other process."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            told = json.loads(line)
            self.words = told["words"]
            self._news.extend(told["alarms"])
            self.alarm = told["alarms"][-1].rpartition(": ")[0] if told["alarms"] else self.alarm


@contextmanager
def tracked_beside(card: Mapping[str, Any], wanted: bool) -> Iterator[Beside | None]:
    """The tracker beside a flight, where it is wanted; it has ended afterwards."""
    if not wanted:
        yield None
        return
    beside = Beside(card)
    try:
        yield beside
    finally:
        beside.close()


def words_of(state: Tracked) -> str:
    """What is known of each axis, in a few words."""
    return ", ".join(f"{name} {axis.state.partition(' (')[0]}" for name, axis in state.axes.items())


def main() -> None:
    """The far end: samples by the standard input, words and alarms by the standard output."""
    from rotorfit.tracking.tracker import Tracker

    os.nice(NICE)
    stream = sys.stdin.buffer
    tracker = Tracker(card_from_mapping(json.loads(stream.readline()), "of the flight"))
    last = tracker.state()

    def tell(state: Tracked) -> None:
        alarms = [f"ALARM {', '.join(one.axes)}: {one.cause}: {one.why}" for one in state.alarms]
        print(json.dumps({"words": words_of(state), "alarms": alarms}), flush=True)

    while len(data := stream.read(RECORD.size)) == RECORD.size:
        number, stamp, received, *values = RECORD.unpack(data)
        name = STREAMS[number]
        tracker.update(Sample(name, stamp, received, tuple(values[: WIDTH[name]])))  # type: ignore[arg-type]
        if tracker.state() is not last:
            last = tracker.state()
            tell(last)


if __name__ == "__main__":
    main()
