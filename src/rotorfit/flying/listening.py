"""Listening: receives from a link, batch by batch, until something ends it; a lost peer is waited for.

A live link is read by a thread of its own, so that slow processing of a sample does not delay the next. Simulated links
and replays are paced. Nothing is sent.
"""

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rotorfit.core.errors import LinkError, LinkOverError
from rotorfit.core.log import Sample
from rotorfit.flying.links.link import Link, wall_clock

PERIOD = 0.05
"""Length of a batch that is simulated or played back, and longest time between two live batches [s]."""

PROMPT = 0.004
"""Length of a live batch, and so the longest time that a sample waits [s]."""

SILENT = 2.0
"""Time without a pose after which the peer counts as gone [s]."""

RETRY = 1.0
"""Time between two attempts to reopen a broken link [s]."""

LEAVING = 5.0
"""How long a live link that was ended may take to hand over what it has received [s]."""


@dataclass(frozen=True)
class Heard:
    """A batch of samples.

    Attributes:
        samples: In the order of arrival.
        now: Time by the link's clock [ns].
        news: One line if the peer is gone or back; otherwise empty.
    """

    samples: tuple[Sample, ...]
    now: int
    news: str = ""


class Listening:
    """Iterates over the batches of a link until it ends; what had been received by then is among them.

    Args:
        opened: Opens the link.
        patience: How long a lost peer is waited for [s].
        seconds: How long to listen, by the link's clock [s]; None for no limit.
        pace: For links that are not live: seconds of their clock per second.
        stopped: Called between batches; returns what the operator did to stop, or an empty string.

    Attributes:
        ended: Why it ended, one line; empty before.
        lost: Whether it ended because the link or the peer was lost.

    Raises:
        LinkError: The link cannot be opened.
    """

    def __init__(
        self,
        opened: Callable[[], Link],
        patience: float,
        seconds: float | None = None,
        pace: float = 1.0,
        stopped: Callable[[], str] = lambda: "",
    ) -> None:
        self.ended, self.lost = "", False
        self._opened, self._patience, self._seconds, self._stopped = opened, patience, seconds, stopped
        self._pace, self._link = pace, opened()
        self._over = threading.Event()

    @property
    def live(self) -> bool:
        """Whether the link's clock is the wall clock."""
        return self._link.live

    @property
    def now(self) -> int:
        """Time by the link's clock [ns]."""
        return self._link.now

    def __iter__(self) -> Iterator[Heard]:
        begun = self._link.now
        heard_at, gone = begun, False
        for batch in self._live() if self._link.live else self._paced():
            if self._over.is_set():  # received before, while the tracker was busy
                yield Heard(batch.samples, batch.now)
                continue
            news = batch.news
            if any(sample.stream == "pose" for sample in batch.samples):
                heard_at = batch.now
                news, gone = (news or "poses come again") if gone else news, False
            elif batch.now - heard_at > SILENT * 1e9 and not gone:
                gone = True
                news = news or f"no pose for {SILENT:g} s: waiting for it {self._patience:g} s"
            yield Heard(batch.samples, batch.now, news)
            if stopped := self._stopped():
                self._end(stopped)
            elif self._seconds is not None and batch.now - begun >= self._seconds * 1e9:
                self._end(f"{self._seconds:g} s have passed")
            elif batch.now - heard_at > max(self._patience, SILENT) * 1e9:
                self._end(f"no pose for {self._patience:g} s", lost=True)

    def _end(self, why: str, lost: bool = False) -> None:
        """Ends it for the first reason that comes."""
        if not self._over.is_set():
            self.ended, self.lost = why, lost
        self._over.set()

    def _paced(self) -> Iterator[Heard]:
        link, begun, start = self._link, self._link.now, time.monotonic()
        step = round(PERIOD * 1e9)
        while not self._over.is_set():
            try:
                samples = link.receive(link.now + step)
            except LinkOverError as over:
                return self._end(str(over))
            yield Heard(tuple(samples), link.now)
            left = (link.now - begun) / 1e9 / self._pace - (time.monotonic() - start)
            self._over.wait(max(left, 0.0))

    def _live(self) -> Iterator[Heard]:
        batches: queue.Queue[Heard | LinkError | None] = queue.Queue()
        thread = threading.Thread(target=self._run, args=(batches,), name="rotorfit-listening", daemon=True)
        thread.start()
        try:
            with suppress(queue.Empty):  # the link does not come back from its last call
                while found := batches.get(timeout=LEAVING if self._over.is_set() else None):
                    if isinstance(found, LinkError):
                        return self._end(str(found), lost=True)
                    yield found
            if not self._over.is_set():
                raise RuntimeError("the thread that listens has failed; its trace is above")
        finally:
            self._over.set()
            thread.join(LEAVING)

    def _run(self, batches: Any) -> None:
        """Body of the thread: a failure of ours ends what it hands over, so that nobody waits for it."""
        try:
            self._read(batches)
        finally:
            batches.put(None)

    def _read(self, batches: Any) -> None:
        """Reads the link, and reopens it if it breaks."""
        link: Link | None = self._link
        broken, since, due = "", 0.0, 0
        while not self._over.is_set():
            try:
                if link is None:
                    link = self._opened()
                samples = link.receive(link.now + round(PROMPT * 1e9))
            except LinkError as error:
                if link is not None:
                    link.act("close")
                    link, broken, since = None, str(error), time.monotonic()
                    batches.put(Heard((), wall_clock(), f"{broken}; waiting for it {self._patience:g} s"))
                elif time.monotonic() - since > self._patience:
                    batches.put(LinkError(f"{broken}; not back within {self._patience:g} s"))
                    return
                self._over.wait(RETRY)
                continue
            if samples or broken or link.now >= due:
                due = link.now + round(PERIOD * 1e9)
                batches.put(Heard(tuple(samples), link.now, "the link is back" if broken else ""))
            broken = ""
        if link is not None:
            link.act("close")
