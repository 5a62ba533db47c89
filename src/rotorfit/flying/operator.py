"""Abort: the operator's way to end a flight: Ctrl-C, the space bar, or a signal that would end the process.

Real time: what a process can do so that its loop is not kept waiting, as far as the system lets it.
"""

import gc
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

Abort = Callable[[], str]
"""Asked once a period: what the operator did, or nothing."""

_SIGNALS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM", signal.SIGHUP: "the terminal was closed"}


@contextmanager
def operator_abort() -> Iterator[Abort]:
    """Watches keyboard and signals without waiting for them; signals no longer end the process meanwhile.

    Yields:
        A function that says what the operator did since the beginning; empty while that is nothing. The space bar
        counts where the input is a terminal, which is put back into its mode at the end.
    """
    pressed: list[str] = []

    def told(number: int, _frame: FrameType | None) -> None:
        pressed.append(_SIGNALS[signal.Signals(number)])

    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, told) for number in _SIGNALS}
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
    """A function that reads what was typed, without waiting; nothing where the input is no terminal."""
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
        termios.tcsetattr(terminal, termios.TCSADRAIN, mode)


PRIORITY, OTHERS = 20, 10
"""Of the loop's thread and of the others, which hold the interpreter's lock now and then; above all ordinary work."""

SWITCH = 0.0002
"""Longest time that another thread may keep the interpreter while the loop waits for it [s]; Python's own is 0.005."""


@contextmanager
def hurried(wall_clock: bool) -> Iterator[str]:
    """No collection of garbage, and real-time priority for all threads, for as long as it lasts.

    Args:
        wall_clock: Whether anything is to be paced; else nothing is changed.

    Yields:
        What the system did not allow, one sentence; empty where it allowed all.
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
    """Puts every thread of the process into the real-time class; remembers what they were in."""
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
    """Whether the system lets the thread be scheduled so."""
    try:
        os.sched_setscheduler(thread, policy, parameter)
    except OSError:  # not permitted, or the thread has ended
        return False
    return True
