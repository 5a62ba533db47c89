"""Behind damage: where a chain of records goes on, in files whose records only say how long they are.

A place is believed to be a record where several records follow each other from it, or all that is left does up to
the end: chance and payload do not give that, so nothing is made up. The search is bounded.
"""

import re
from collections.abc import Callable, Iterator
from itertools import islice
from mmap import mmap

CHAIN = 4
"""Records that must follow each other where reading goes on."""

MOST_TRIED = 1 << 20
"""Places that are tried behind one damage; a second or two."""

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
    """Places of a pattern from one on."""
    return (match.start() for match in pattern.finditer(data, start))
