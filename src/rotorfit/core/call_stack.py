"""Memory for the frames of Python's calls.

CPython (seen in 3.11 to 3.13) takes it in chunks of 16 kB and gives each back when it is empty. Where the frame of a
function that C code calls is the first of a chunk, every call maps and unmaps memory: where numba compiles, a million
times, a third of the processor time.
"""

from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")

SLOTS = 66_000
"""Size of the frame of `with_room` [pointers]: its chunk is 1 MB (a power of two), of which nearly half is left."""


def with_room(call: Callable[[], Result]) -> Result:
    """Calls from a frame so large that those of all further calls fit into its chunk.

    Args:
        call: Its frames, and those of what it calls, may take half a megabyte before the next chunk.

    Returns:
        What the call returns.
    """
    return call()


with_room.__code__ = with_room.__code__.replace(co_stacksize=SLOTS)
