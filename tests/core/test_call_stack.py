"""Room for the frames of calls: at no depth does a loop of calls map memory at each of them."""

import resource

import pytest

from rotorfit.core.call_stack import with_room

CALLS = 300


def most_faults(depth: int = 400) -> int:
    """The most page faults of a loop of calls from C, of loops at this and all lower depths."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    list(map(empty, range(CALLS)))
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    return max(faults, most_faults(depth - 1)) if depth else faults


def empty(_: int) -> None:
    """A call whose frame is the first of a new chunk, at some depths."""


def test_no_loop_of_calls_maps_memory_at_each_of_them() -> None:
    if most_faults() < CALLS:
        pytest.skip("this Python keeps its memory by itself, or this system does not count page faults")
    assert with_room(most_faults) < CALLS / 10


def test_what_the_call_returns_and_raises_is_passed_on() -> None:
    assert with_room(lambda: 3) == 3
    with pytest.raises(ZeroDivisionError):
        with_room(lambda: 1 // 0)
