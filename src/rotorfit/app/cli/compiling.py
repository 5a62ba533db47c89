"""The message that explains why the first run after an installation takes longer: numba compiles."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import click

WORTH_A_LINE = 1.0
"""Time of compiling after which the message is shown [s]."""

LINE = "Compiling, once after an installation: this run takes longer than the next ones."


@contextmanager
def compiling_announced() -> Iterator[None]:
    """Says on stderr, if that is a terminal, that code is being compiled if that takes long."""
    if not sys.stderr.isatty():
        yield
        return
    from numba.core import event

    event.Listener.register(_Compiling)
    with event.install_listener("numba:compile", _Compiling()):
        yield


class _Compiling:
    """A listener for numba's events: compilations begin and end, nested if functions call functions."""

    def __init__(self) -> None:
        self._depth, self._since, self._spent, self._announced = 0, 0.0, 0.0, False

    def notify(self, event: Any) -> None:
        """Adds up the time; loading from the cache is not an event."""
        now = perf_counter()
        if event.is_start and not self._depth:
            self._since = now
        self._depth += 1 if event.is_start else -1
        if not self._announced and self._spent + now - self._since >= WORTH_A_LINE:
            self._announced = True
            click.echo(LINE, err=True)
        if not self._depth:
            self._spent += now - self._since
