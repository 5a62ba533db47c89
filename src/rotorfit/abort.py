"""Abort: the operator's way to end a flight: Ctrl-C, the space bar, or a signal that would end the process."""

import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
