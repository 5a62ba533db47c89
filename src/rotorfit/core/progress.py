"""Progress of a long computation, reported to its caller."""

from collections.abc import Callable

Progress = Callable[[float, str], None]


def part_of(progress: Progress | None, place: int, of: int) -> Progress | None:
    """Maps the progress of one of several equal parts onto the whole; None stays None."""
    if progress is None:
        return None
    outer = progress
    return lambda fraction, text: outer((place + fraction) / of, text)
