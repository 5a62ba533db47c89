"""The operator's abort, and real-time scheduling of the flight loop.

The operator ends a flight by Ctrl-C, the space bar, or a signal that would end the process. Real-time scheduling keeps
the loop from waiting for other work, as far as the system allows it.
"""

import gc
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

Abort = Callable[[], str]
"""Called once a period; returns what the operator did to end the flight, or an empty string."""

_SIGNALS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "the terminal was closed"}


@contextmanager
def operator_abort() -> Iterator[Abort]:
    """Watches keyboard and signals without blocking; meanwhile signals do not end the process.

    Yields:
        A function that returns what the operator has done to end the flight, or an empty string. The space bar counts
        if the input is a terminal, whose mode is restored on exit.
    """
    pressed: list[str] = []

    def interrupted(number: int, _frame: FrameType | None) -> None:
        pressed.append(_SIGNALS[signal.Signals(number)])

    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, interrupted) for number in _SIGNALS}
    try:
        with _keys() as keys:

            def abort() -> str:
                if not pressed and b" " in keys():
                    pressed.append("the space bar")
                return pressed[0] if pressed else ""

            yield abort
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _keys() -> Iterator[Callable[[], bytes]]:
    """A function that reads typed keys without blocking; it returns none if the input is not a terminal."""
    if sys.stdin is None or sys.stdin.closed or not sys.stdin.isatty():
        yield lambda: b""
        return
    import termios
    import tty

    terminal = sys.stdin.fileno()
    mode = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        yield lambda: os.read(terminal, 64) if select.select([terminal], [], [], 0)[0] else b""
    finally:
        with suppress(termios.error):  # the terminal was closed
            termios.tcsetattr(terminal, termios.TCSANOW, mode)  # a paused terminal would not drain


PRIORITY, OTHERS = 20, 10
"""Real-time priority of the loop's thread, and of the others, which hold the interpreter's lock now and then."""

SWITCH = 0.0002
"""Longest time that another thread may hold the interpreter while the loop waits for it [s]; Python's default is
0.005."""


@contextmanager
def hurried(wall_clock: bool) -> Iterator[str]:
    """Disables garbage collection and gives all threads real-time priority, until exit.

    Args:
        wall_clock: Whether the loop is paced by the wall clock; otherwise nothing is changed.

    Yields:
        A sentence on what the system did not allow; empty if it allowed all.
    """
    if not wall_clock:
        yield ""
        return
    collecting, interval = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH)
    before: dict[int, tuple[int, os.sched_param]] = {}
    try:
        yield _raised(before)
    finally:
        for thread, (policy, parameter) in before.items():
            _schedule(thread, policy, parameter)
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if collecting:
            gc.enable()


def _raised(before: dict[int, tuple[int, os.sched_param]]) -> str:
    """Puts every thread of the process into the real-time class, and stores the former class in `before`."""
    allowed = hasattr(os, "SCHED_FIFO") and Path("/proc/self/task").is_dir()
    if allowed:
        own = threading.get_native_id()
        for thread in [int(entry.name) for entry in Path("/proc/self/task").iterdir()]:
            try:
                was = os.sched_getscheduler(thread), os.sched_getparam(thread)
            except ProcessLookupError:  # it has ended meanwhile
                continue
            if _schedule(thread, os.SCHED_FIFO, os.sched_param(PRIORITY if thread == own else OTHERS)):
                before[thread] = was
            else:
                allowed = allowed and thread != own
    if allowed:
        return ""
    return (
        "no real-time priority: on a busy computer commands may come late "
        "(allow it: `ulimit -r 20`, or rtprio in /etc/security/limits.conf)"
    )


def _schedule(thread: int, policy: int, parameter: os.sched_param) -> bool:
    """Sets the scheduling of a thread; whether the system allows it."""
    try:
        os.sched_setscheduler(thread, policy, parameter)
    except OSError:  # not permitted, or the thread has ended
        return False
    return True
