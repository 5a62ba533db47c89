"""Progress: what a long computation tells its caller, and parts of it."""

from collections.abc import Callable

Progress = Callable[[float, str], None]


def part_of(progress: Progress | None, place: int, of: int) -> Progress | None:
    """Progress of one of several equal parts."""
    if progress is None:
        return None
    outer = progress
    return lambda fraction, text: outer((place + fraction) / of, text)
