"""Listening: what a link hears, batch by batch, until something ends it; a peer that goes is waited for.

A live link is read by a thread of its own, so that nothing that the listener does with a sample lets others wait. What
is simulated or played back passes at a pace. Nothing is sent.
"""

import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from rotorfit.core.errors import LinkError, LinkOverError
from rotorfit.core.log import Sample
from rotorfit.flying.links.link import Link, wall_clock

PERIOD = 0.05
"""Time that a batch takes of what is played back, and after which an empty one comes [s]."""

PROMPT = 0.004
"""Time that a live batch takes [s]: a sample waits no longer."""

SILENT = 2.0
"""Without a pose for so long the peer is gone [s]."""

RETRY = 1.0
"""Between two tries to open a link again that broke [s]."""


@dataclass(frozen=True)
class Heard:
    """A batch.

    Attributes:
        samples: In the order of arrival.
        now: By the link's clock [ns].
        news: Of the peer, one line: that it is gone, that it is back; empty else.
    """

    samples: tuple[Sample, ...]
    now: int
    news: str = ""


class Listening:
    """Hears a link until it ends.

    Args:
        opened: Opens it.
        patience: How long a peer that went is waited for [s].
        seconds: How long to listen, by the link's clock [s]; None for as long as it lasts.
        pace: Of links that are not live: seconds of theirs a second.
        stopped: Asked between batches: what the operator did, or nothing.

    Attributes:
        ended: Why it ended, one line; empty while it has not.
        lost: Whether that is the link's or the peer's fault.

    Raises:
        LinkError: It cannot be opened.
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

    @property
    def live(self) -> bool:
        """Whether the link's clock is that on the wall."""
        return self._link.live

    def __iter__(self) -> Iterator[Heard]:
        begun = self._link.now
        heard_at, gone = begun, False
        for batch in self._live() if self._link.live else self._paced():
            news = batch.news
            if any(sample.stream == "pose" for sample in batch.samples):
                heard_at = batch.now
                news, gone = (news or "poses come again") if gone else news, False
            elif batch.now - heard_at > SILENT * 1e9 and not gone:
                gone = True
                news = news or f"no pose for {SILENT:g} s: waiting for it {self._patience:g} s"
            yield Heard(batch.samples, batch.now, news)
            if stopped := self._stopped():
                return self._end(stopped)
            if self._seconds is not None and batch.now - begun >= self._seconds * 1e9:
                return self._end(f"{self._seconds:g} s are over")
            if batch.now - heard_at > max(self._patience, SILENT) * 1e9:
                return self._end(f"no pose for {self._patience:g} s", lost=True)
        return None

    def _end(self, why: str, lost: bool = False) -> None:
        self.ended, self.lost = self.ended or why, self.lost or lost

    def _paced(self) -> Iterator[Heard]:
        link, begun, start = self._link, self._link.now, time.monotonic()
        step = round(PERIOD * 1e9)
        while True:
            try:
                samples = link.receive(link.now + step)
            except LinkOverError as over:
                return self._end(str(over))
            yield Heard(tuple(samples), link.now)
            left = (link.now - begun) / 1e9 / self._pace - (time.monotonic() - start)
            time.sleep(max(left, 0.0))

    def _live(self) -> Iterator[Heard]:
        batches: queue.Queue[Heard | LinkError] = queue.Queue()
        over = threading.Event()
        thread = threading.Thread(target=self._run, args=(batches, over), name="rotorfit-listening", daemon=True)
        thread.start()
        try:
            while True:
                found = batches.get()
                if isinstance(found, LinkError):
                    return self._end(str(found), lost=True)
                yield found
        finally:
            over.set()
            thread.join(5.0)

    def _run(self, batches: Any, over: threading.Event) -> None:
        """The thread: reads, and opens the link again where it broke."""
        link: Link | None = self._link
        broken, since, due = "", 0.0, 0
        while not over.is_set():
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
                over.wait(RETRY)
                continue
            if samples or broken or link.now >= due:
                due = link.now + round(PERIOD * 1e9)
                batches.put(Heard(tuple(samples), link.now, "the link is back" if broken else ""))
            broken = ""
        if link is not None:
            link.act("close")
