"""Independent parts of the work on long flights, in threads: compiled code runs beside other compiled code.

On short flights most of the time is Python's own, of which only one thread at a time can run.
"""

import ctypes
import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

LONG = 120.0
"""Duration of the flights together from which threads pay [s]."""

NAME = "rotorfit-part"
"""Beginning of the names of the threads."""

ONE_HEAP = (-8, 1)
"""M_ARENA_MAX of glibc's malloc.h, and its value for one heap."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def each(work: Callable[[Item], Result], items: Iterable[Item], seconds: float) -> Iterator[Result]:
    """The results of some work on every item, in their order; they do not depend on the number of threads.

    Threads begin at once. On short flights the work on an item is done when its result is asked for.

    Args:
        work: May not change anything that the work on another item uses.
        items: Its arguments.
        seconds: Duration of the flights that it goes through [s]; short ones take no threads.

    Raises:
        Exception: What the work raised on the first item that failed.
    """
    if seconds < LONG or processors() == 1:
        return map(work, items)
    _share_heap()
    pool = ThreadPoolExecutor(processors(), NAME)
    results = pool.map(work, items)  # an error, or an end before the last result, cancels what has not begun
    pool.shutdown(wait=False)
    return results


def _share_heap() -> None:
    """Makes later threads allocate from the heap of the process, where the C library is glibc.

    By default each gets a heap of its own, and what one of them has freed the others cannot use: a fourth of the memory
    of a fit of half an hour.
    """
    if sys.platform == "linux" and hasattr(library := ctypes.CDLL(None), "mallopt"):
        library.mallopt(*ONE_HEAP)


def processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def abandoned() -> bool:
    """Whether threads still work on parts whose results nobody waits for, as after an interruption."""
    return any(thread.name.startswith(NAME) for thread in threading.enumerate())
