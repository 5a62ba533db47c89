"""Prints from a thread of its own, so that a reader who stalls (a paused terminal, a slow program) holds up nothing.

Nor does one who goes away: what must be told is then printed elsewhere.
"""

import queue
import threading
import time
from collections.abc import Callable, Sequence

MOST = 1000
"""Number of prints that wait for the reader; beyond, those that may be spared are left out."""

STALLED = 5.0
"""Time without the reader taking anything after which it has stalled [s]."""


class Printer:
    """Prints to one stream, in order.

    Args:
        beside: Whether from a thread; otherwise at once.
        redirects: Called in turn when the stream takes nothing any more; each lets it end elsewhere.

    Attributes:
        spared: Number of prints that were left out because too many waited.
        fault: Why the stream takes nothing any more; empty while it does.
    """

    def __init__(self, beside: bool, redirects: Sequence[Callable[[], None]] = ()) -> None:
        self.spared, self.fault = 0, ""
        self._redirects = list(redirects)
        self._taken, self._done, self._moved = 0, 0, time.monotonic()
        self._waiting: queue.SimpleQueue[tuple[Callable[[], None], bool] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="rotorfit-printer", daemon=True) if beside else None
        if self._thread:
            self._thread.start()

    def take(self, work: Callable[[], None], spare: bool = False) -> None:
        """Takes the next print.

        Args:
            work: Prints something.
            spare: Whether it may be left out, where too many wait or the stream takes nothing any more.

        Raises:
            OSError: Without a thread, the stream takes nothing any more.
        """
        if self._thread is None:
            work()
        elif spare and self._taken - self._done >= MOST:
            self.spared += 1
        else:
            self._moved = time.monotonic() if self._taken == self._done else self._moved
            self._taken += 1
            self._waiting.put((work, spare))

    @property
    def stalled(self) -> bool:
        """Whether something waits, and the reader has taken nothing for `STALLED` seconds."""
        return self._taken > self._done and time.monotonic() - self._moved > STALLED

    def close(self, patient: bool) -> bool:
        """Ends it when all is printed.

        Args:
            patient: Whether to wait for a reader who has stalled, until Ctrl-C.

        Returns:
            Whether all was printed. If not, the thread holds the stream, which Python's own end would wait for.

        Raises:
            RuntimeError: A print has failed.
        """
        self._waiting.put(None)
        try:
            while self._thread and self._thread.is_alive():
                if self.stalled and not patient:
                    return False
                self._thread.join(0.1)
        except KeyboardInterrupt:
            return False
        if self._taken > self._done:
            raise RuntimeError("the thread that prints has failed; its trace is above")
        return True

    def _run(self) -> None:
        """Body of the thread."""
        while found := self._waiting.get():
            self._print(*found)
            self._moved = time.monotonic()
            self._done += 1

    def _print(self, work: Callable[[], None], spare: bool) -> None:
        """Prints, and what may not be left out elsewhere if need be."""
        if spare and self.fault:
            return
        try:
            work()
        except OSError as error:
            if not self._redirects:
                raise
            self.fault = error.strerror or str(error)
            self._redirects.pop(0)()
            self._print(work, spare)
