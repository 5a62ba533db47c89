"""The shelf: a cache of what was computed from logs and cards, so that every page draws at once."""

import sys
from collections import OrderedDict
from collections.abc import Callable, Hashable
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar, cast

import numpy as np

from rotorfit.app.web.card_lines import card_from_text
from rotorfit.app.web.windowed import Series, series_over
from rotorfit.app.web.workspace import Upload, Workspace
from rotorfit.assessment.evidence import command_and_velocity
from rotorfit.core.errors import LogError, RotorfitError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.log import Log
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import clock_of, raw_column, table_of
from rotorfit.flights.stamps import MISSING_STAMP, stamps_of

BUDGET = 1 << 30
"""Largest total size of the cached arrays [bytes]."""

Made = TypeVar("Made")


class Shelf:
    """Cache of logs, flights and series of a workspace; the least recently used are dropped first."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._making: dict[Hashable, Lock] = {}
        self._lock = Lock()

    def log(self, upload: Upload) -> Log:
        """A log; errors and findings use the user's name for it.

        Raises:
            LogError: It cannot be read.
        """

        def make() -> Log:
            """Reads it."""
            path = self._workspace.path_of(upload)
            try:
                found = read(path)
            except LogError as error:
                raise LogError(str(error).replace(str(path), upload.name)) from None
            return Log(**{**vars(found), "path": Path(upload.name)})

        return self._keep(("log", upload.id), make)

    def flight(self, upload: Upload, card: str) -> Flight:
        """The flight that a card makes from a log.

        Raises:
            RotorfitError: The card is wrong or does not fit, or there is no usable flight.
        """
        return self._keep(("flight", upload.id, card), lambda: flight_from_log(self.log(upload), card_from_text(card)))

    def motion(self, upload: Upload, card: str, axis: str) -> Series:
        """Command and measured velocity of an axis, in the heading frame, over the flight."""

        def make() -> list[Series]:
            time, command, velocity = command_and_velocity(self.flight(upload, card))
            return [series_over(time, np.column_stack(pair)) for pair in zip(command.T, velocity.T, strict=True)]

        return self._keep(("motion", upload.id, card), make)[AXES.index(axis)]

    def column(self, upload: Upload, source: str) -> Series:
        """A column as recorded, over the clock of its table, or over its rows if the table has no clock.

        Raises:
            CardError: There is no such column.
        """
        return self._keep(("column", upload.id, source), lambda: _column(self.log(upload), source))

    def computed(self, key: tuple[Hashable, ...], make: Callable[[], Made]) -> Made:
        """Any other expensive result."""
        return self._keep(("computed", *key), make)

    def forget(self, upload: Upload) -> None:
        """Drops everything cached for a log."""
        with self._lock:
            for key in [key for key in self._kept if isinstance(key, tuple) and upload.id in key]:
                del self._kept[key]

    def _keep(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """The cached result; computed once, however many threads ask. Known errors are cached too."""
        with self._lock:
            making = self._making.setdefault(key, Lock())
        with making:
            with self._lock:
                if key in self._kept:
                    self._kept.move_to_end(key)
                    return cast("Made", _given(self._kept[key][0]))
            made: Made | RotorfitError
            try:
                made = make()
            except RotorfitError as error:
                made = error
            with self._lock:
                self._kept[key] = (made, size_of(made))
                self._making.pop(key, None)
                while len(self._kept) > 1 and sum(size for _, size in self._kept.values()) > BUDGET:
                    self._kept.popitem(last=False)
            return cast("Made", _given(made))


def _given(made: Any) -> Any:
    if isinstance(made, RotorfitError):
        raise made.with_traceback(None)
    return made


def size_of(thing: Any) -> int:
    """Size of the arrays in a noun [bytes]."""
    if isinstance(thing, np.ndarray):
        return thing.nbytes
    if isinstance(thing, Log):
        return sum(values.nbytes for table in thing.tables.values() for values in table.columns.values())
    if isinstance(thing, list | tuple):
        return sum(map(size_of, thing))
    fields = getattr(thing, "__dataclass_fields__", None)
    return sum(size_of(getattr(thing, name)) for name in fields) if fields else sys.getsizeof(thing)


def _column(log: Log, source: str) -> Series:
    table, _ = table_of(log, source)
    raw = raw_column(log, source)[1]
    clock = clock_of(log, table, raw.size)
    values = raw.astype(np.float64)
    if clock is None:
        return series_over(np.arange(raw.size, dtype=np.float64), values[:, None])
    stamps = stamps_of(log, clock)
    count = min(stamps.size, values.size)
    stamps, values = stamps[:count], values[:count]
    known = np.isfinite(values) & (stamps != MISSING_STAMP)
    stamps, values = stamps[known], values[known]
    zero = _zero(log, int(stamps.min(initial=np.iinfo(np.int64).max)))
    order = np.argsort(stamps, kind="stable") if np.any(np.diff(stamps) < 0) else slice(None)
    return series_over((stamps[order] - zero) / 1e9, values[order][:, None])


def _zero(log: Log, own: int) -> int:
    """The first stamp of any table within a day of `own`: tables of one clock share their time 0."""
    day = 86_400_000_000_000
    firsts = []
    for table in log.tables.values():
        clock = clock_of(log, table, max((c.size for c in table.columns.values()), default=0))
        if clock is not None:
            stamps = stamps_of(log, clock)
            known = stamps[stamps != MISSING_STAMP]
            firsts += [int(known.min())] if known.size else []
    return min((first for first in firsts if abs(first - own) < day), default=own)
