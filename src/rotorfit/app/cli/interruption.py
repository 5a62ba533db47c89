"""Ctrl-C that waits while LLVM calls back into Python.

numba loads compiled code through callbacks from LLVM. Exceptions cannot propagate through LLVM: one that is raised in a
callback is dropped there, the function stays empty, and its first call ends the process with a segmentation fault.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

RETRY = 0.01
"""Time after which the interrupt is tried again [s]."""


@contextmanager
def safe_interrupts() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt as usual, but never in a callback; any other handler is left in place."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    before = signal.signal(signal.SIGALRM, _interrupt)
    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    except SystemError as error:  # it struck while a compiled function handed over its result
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise error.__cause__ from None
        raise
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGALRM, before)


def _interrupt(_number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_globals.get("__name__", "").startswith("llvmlite"):
            signal.setitimer(signal.ITIMER_REAL, RETRY)
            return
        frame = frame.f_back
    raise KeyboardInterrupt
