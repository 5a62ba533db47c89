"""The message that explains why the first run after an installation takes longer: numba compiles."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import click

WORTH_A_LINE = 1.0
"""Time of compiling after which the message is shown [s]."""

COMPILING = "compiling "
"""Beginning of the text of a progress that compiles (`first_use.TEXT`)."""

LINE = "Compiling, once after an installation: this run takes longer than the next ones."


@contextmanager
def compiling_announced() -> Iterator[Callable[[], None]]:
    """Says on stderr, if that is a terminal, that code is being compiled if that takes long.

    Yields what says so at once, where other processes compile; it is said once.
    """
    if not sys.stderr.isatty():
        yield lambda: None
        return
    from numba.core import event

    event.Listener.register(_Compiling)
    with event.install_listener("numba:compile", listener := _Compiling()):
        yield listener.announce


class _Compiling:
    """A listener for numba's events: compilations begin and end, nested if functions call functions."""

    def __init__(self) -> None:
        self._depth, self._since, self._spent, self._announced = 0, 0.0, 0.0, False

    def announce(self) -> None:
        """Says it, unless it was said."""
        if not self._announced:
            self._announced = True
            click.echo(LINE, err=True)

    def notify(self, event: Any) -> None:
        """Adds up the time; loading from the cache is not an event."""
        now = perf_counter()
        if event.is_start and not self._depth:
            self._since = now
        self._depth += 1 if event.is_start else -1
        if self._spent + now - self._since >= WORTH_A_LINE:
            self.announce()
        if not self._depth:
            self._spent += now - self._since
