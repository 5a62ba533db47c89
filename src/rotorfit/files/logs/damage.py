"""Losses: holes in a bag, in bytes and in time.

Behind damage: where a chain of records goes on, in files whose records only say how long they are.

A place is believed to be a record where several records follow each other from it, or all that is left does up to
the end: chance and payload do not give that, so nothing is made up. The search is bounded.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from mmap import mmap

from rotorfit.files.logs.content import BLOCK_LIMIT, one_line

_MOST, _MANY = 100, 5000  # holes told by themselves; holes at which reading ends


@dataclass
class _Loss:
    """A hole.

    Attributes:
        place: Where in the file.
        size: Of the file.
        count: Bytes that are lost.
        why: What is wrong there.
        since: When the message before was recorded [ns]; None where there was none.
        gap: Time from there to the next message [s]; None where none was read since.
    """

    place: int
    size: int
    count: int
    why: str
    since: int | None
    gap: float | None = None


class Losses:
    """Holes of a bag, taken down between the messages.

    Attributes:
        until: When the last message was recorded [ns]; None before the first one.
    """

    def __init__(self) -> None:
        self.until: int | None = None
        self._losses: list[_Loss] = []
        self._holes = 0

    def found(self, place: int, size: int, count: int, why: str) -> None:
        """Takes down a hole between the messages seen so far and those that follow.

        Args:
            place: Of the damage in the file.
            size: Of the file.
            count: Bytes that are lost.
            why: What is wrong there.
        """
        self._holes += 1
        if self._losses and (self._losses[-1].gap is None or len(self._losses) == _MOST):
            self._losses[-1].count += count  # one hole; or enough of them to tell
        else:
            self._losses.append(_Loss(place, size, count, why, self.until))

    @property
    def many(self) -> bool:
        """Whether there are more holes than any disk makes: it is not worth while to look behind them."""
        return self._holes >= _MANY

    def seen(self, first: int, last: int) -> None:
        """Takes down when messages were recorded [ns], and with it how long the hole before them is."""
        if self._losses and self._losses[-1].gap is None:
            since = self._losses[-1].since
            self._losses[-1].gap = 0.0 if since is None else max(first - since, 0) / 1e9
        self.until = last

    def texts(self) -> list[str]:
        """What is said of them, in one line: how much of the file and of the time is gone; nothing if it is whole."""
        if not self._losses:
            return []
        first, count = self._losses[0], sum(loss.count for loss in self._losses)
        gaps = [loss.gap for loss in self._losses if loss.gap]
        where = (
            "damaged"
            if len(self._losses) == 1
            else f"damaged in {len(self._losses)}{' or more' * (len(self._losses) == _MOST)} places, first"
        )
        said = [f"{where} at byte {first.place} of {first.size} ({first.why}): {count} bytes lost"]
        if gaps:
            said.append(f"{sum(gaps):.3g} s without a message")
        if self._losses[-1].gap is None:
            said.append("and what was recorded behind them")
        return [one_line(", ".join(said))]


CHAIN = 4
"""Records that must follow each other where reading goes on."""

MOST_TRIED = 1 << 20
"""Places that are tried behind one damage; a second or two."""

MOST_SEARCHED = 4 * BLOCK_LIMIT
"""Bytes that are searched behind one damage, a second or two: a hole in a file is gigabytes of zeros."""

Block = bytes | mmap

After = Callable[[Block, int], int | None]


def resumed(data: Block, places: Iterator[int], after: After) -> int | None:
    """Where a chain of records goes on.

    Args:
        data: A block, or a file.
        places: Where a record may begin, ascending.
        after: End of the record that begins at a place, at most that of the data; None where none can.

    Returns:
        The first place from which `CHAIN` records follow each other, or all up to the end; None where there is none.
    """
    return next((place for place in islice(places, MOST_TRIED) if _chained(data, place, after)), None)


def _chained(data: Block, place: int, after: After) -> bool:
    for _ in range(CHAIN):
        following = after(data, place)
        if following is None or following >= len(data):
            return following is not None
        place = following
    return True


def matches(pattern: re.Pattern[bytes], data: Block, start: int) -> Iterator[int]:
    """Places of a pattern from one on, as far as is searched."""
    return (match.start() for match in pattern.finditer(data, start, start + MOST_SEARCHED))
