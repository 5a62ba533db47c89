"""The line that says why the first run after an installation takes longer: numba compiles for it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import click

WORTH_A_LINE = 1.0
"""Seconds of compiling after which it is said."""

LINE = "Compiling, once after an installation: this run takes longer than the next ones."


@contextmanager
def compiling_told() -> Iterator[None]:
    """Says on stderr, where that is a terminal, that code is compiled where that takes its time."""
    if not sys.stderr.isatty():
        yield
        return
    from numba.core import event

    event.Listener.register(_Compiling)
    with event.install_listener("numba:compile", _Compiling()):
        yield


class _Compiling:
    """A listener of numba: a compilation begins or ends, inside of others where functions call functions."""

    def __init__(self) -> None:
        self._depth, self._since, self._spent, self._told = 0, 0.0, 0.0, False

    def notify(self, event: Any) -> None:
        """Adds up the time; what comes out of the cache is no event."""
        now = perf_counter()
        if event.is_start and not self._depth:
            self._since = now
        self._depth += 1 if event.is_start else -1
        if not self._told and self._spent + now - self._since >= WORTH_A_LINE:
            self._told = True
            click.echo(LINE, err=True)
        if not self._depth:
            self._spent += now - self._since
