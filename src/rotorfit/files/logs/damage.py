"""Losses: holes in a bag, in bytes and in time.

Recovery behind damage: where a chain of records resumes, in files whose records only state their length.

A position is accepted as a record if several records follow from it, or all the rest up to the end: neither chance nor
payload produces that, so no data are invented. The search is bounded.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from mmap import mmap

from rotorfit.files.logs.content import BLOCK_LIMIT, one_line

_MOST, _MANY = 100, 5000  # holes listed separately; holes at which reading ends


@dataclass
class _Loss:
    """A hole.

    Attributes:
        place: Its offset in the file.
        size: Size of the file [byte].
        count: Bytes lost.
        why: What is wrong there.
        since: When the previous message was recorded [ns]; None if there was none.
        gap: Time from there to the next message [s]; None if none has been read since.
    """

    place: int
    size: int
    count: int
    why: str
    since: int | None
    gap: float | None = None


class Losses:
    """Holes of a bag, recorded between the messages.

    Attributes:
        until: When the last message was recorded [ns]; None before the first one.
    """

    def __init__(self) -> None:
        self.until: int | None = None
        self._losses: list[_Loss] = []
        self._holes = 0

    def found(self, place: int, size: int, count: int, why: str) -> None:
        """Records a hole between the messages seen so far and those that follow.

        Args:
            place: Offset of the damage in the file.
            size: Size of the file [byte].
            count: Bytes lost.
            why: What is wrong there.
        """
        self._holes += 1
        if self._losses and (self._losses[-1].gap is None or len(self._losses) == _MOST):
            self._losses[-1].count += count  # the same hole; or the list is full
        else:
            self._losses.append(_Loss(place, size, count, why, self.until))

    @property
    def many(self) -> bool:
        """Whether there are more holes than a faulty disk makes: searching behind them is pointless."""
        return self._holes >= _MANY

    def seen(self, first: int, last: int) -> None:
        """Records when messages were recorded [ns], and so the length of the hole before them."""
        if self._losses and self._losses[-1].gap is None:
            since = self._losses[-1].since
            self._losses[-1].gap = 0.0 if since is None else max(first - since, 0) / 1e9
        self.until = last

    def texts(self) -> list[str]:
        """Summary in one line: how much of the file and of the time is lost; empty if the file is whole."""
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
"""Number of consecutive records required where reading resumes."""

MOST_TRIED = 1 << 20
"""Most positions tried behind one damage; a second or two."""

MOST_SEARCHED = 4 * BLOCK_LIMIT
"""Most bytes searched behind one damage, a second or two: a hole in a file can be gigabytes of zeros."""

Block = bytes | mmap

After = Callable[[Block, int], int | None]


def resumed(data: Block, places: Iterator[int], after: After) -> int | None:
    """Finds where a chain of records resumes.

    Args:
        data: A block, or a file.
        places: Positions at which a record may begin, ascending.
        after: End of the record that begins at a position, at most that of the data; None if none can begin there.

    Returns:
        The first position from which `CHAIN` records follow each other, or all up to the end; None if there is none.
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
    """Positions of a pattern from `start` on, within the search limit."""
    return (match.start() for match in pattern.finditer(data, start, start + MOST_SEARCHED))
