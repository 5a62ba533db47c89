"""Logs of every known format as one noun: `read(path) -> Log`.

A format is recognised by the first bytes of a file, never by its name. Each format is a module with
`sniff(path, head) -> bool` and `read(path, tables) -> Content`, imported on demand; third-party packages are imported
only when it reads.
"""

import hashlib
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from threading import Event

from rotorfit.core.errors import LogError
from rotorfit.core.log import Log
from rotorfit.core.progress import Progress, part_of
from rotorfit.files.kinds import text_kind, told_instead
from rotorfit.files.logs.content import Content, check_width, one_line
from rotorfit.files.logs.formats import FORMATS
from rotorfit.files.logs.several import join_logs, parts_of
from rotorfit.files.logs.unknown import told_unknown

__all__ = ["FORMATS", "HEAD", "format_of", "read"]

HEAD = 1 << 16
"""Bytes by which a file is known: two lines of the widest CSV."""

_BLOCK = 1 << 22  # bytes hashed at once, without holding up the thread that reads

_LARGE = 100_000_000  # bytes above which progress is reported


def read(path: str | Path, tables: Collection[str] | None = None, progress: Progress | None = None) -> Log:
    """Reads a log.

    Args:
        path: A file, or the folder of a ROS 2 bag; or several files of one flight, `A+B`.
        tables: Names of the tables to decode; None decodes every numeric table (not images, point clouds and the like).
            The others are listed in `Log.skipped`. Files of one table (CSV, MAT) and several files of one flight are
            always read whole.
        progress: Called from another thread with a fraction and a text, for files of more than 100 MB; raising in it
            cancels.

    Returns:
        The log as recorded; losses are in its `damage`, recoveries in its `notes`.

    Raises:
        LogError: Missing, empty or unreadable file, unknown format, no table in it, damage before the first message.
    """
    parts = parts_of(path)
    if len(parts) > 1:
        return join_logs([read(part, None, part_of(progress, n, len(parts))) for n, part in enumerate(parts)])
    path = Path(path)
    try:
        head = _head(path)
        if name := format_of(path, head):
            with _hashed(path, progress) as digest:
                content: Content = import_module(FORMATS[name].module).read(
                    path, None if tables is None else frozenset(tables)
                )
                check_width(path, max((len(table.columns) for table in content.tables.values()), default=0))
                found = (content.tables, content.skipped, content.notes, content.attached, content.events)
                return Log(path, name, digest(), *found, damage=content.damage, units=content.units)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({one_line(error)}); check the path and its permissions") from error
    if path.is_dir():
        raise LogError(
            f"{path}: a folder without metadata.yaml is no ROS 2 bag; name a file in it, "
            "or rebuild the metadata with `ros2 bag reindex`"
        )
    if kind := text_kind(head):
        raise LogError(told_instead(path, kind, "log"))
    raise LogError(f"{path}: {told_unknown(head)}")


def format_of(path: Path, head: bytes) -> str:
    """Name of the format of a file, by its first bytes; empty where none is known."""
    return next((name for name, form in FORMATS.items() if import_module(form.module).sniff(path, head)), "")


def _head(path: Path) -> bytes:
    """First bytes of a file; empty for a folder.

    Raises:
        LogError: Missing, empty, or not a regular file.
    """
    if path.is_dir():
        return b""
    if not path.exists():
        raise LogError(f"{path}: no such file; check the path")
    if not path.is_file():
        raise LogError(f"{path}: not a regular file; copy the log to one")
    with path.open("rb") as file:
        head = file.read(HEAD)
    if not head:
        raise LogError(f"{path}: the file is empty; check that the recording was written and copied whole")
    return head


@contextmanager
def _hashed(path: Path, progress: Progress | None) -> Iterator[Callable[[], str]]:
    """Yields a function that returns the SHA-256 of a file, computed in a second thread that stops with the context."""
    stop = Event()
    with ThreadPoolExecutor(1) as pool:
        digest = pool.submit(_sha256, path, stop, progress)
        try:
            yield digest.result
        finally:
            stop.set()


def _sha256(path: Path, stop: Event, progress: Progress | None) -> str:
    """Hex digest of a file; for a folder, of the bytes of its files in the order of their names.

    It reports the progress for large files, because reading them rarely takes longer than hashing.
    """
    digest = hashlib.sha256()
    files = sorted(entry for entry in path.iterdir() if entry.is_file()) if path.is_dir() else [path]
    total, done = sum(entry.stat().st_size for entry in files), 0
    text = one_line(f"reading {path.name}, {total / 1e6:.0f} MB")
    block = bytearray(_BLOCK)
    view = memoryview(block)
    for entry in files:
        with entry.open("rb", buffering=0) as file:
            while (size := file.readinto(block)) and not stop.is_set():
                digest.update(view[:size])
                done += size
                if progress and total > _LARGE:
                    progress(min(done / total, 1.0), text)
    return digest.hexdigest()
