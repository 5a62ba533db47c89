"""Writing: a file is the old one or the new one, whole, whatever happens meanwhile: a full disk, a kill, no power."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile


def write_whole(path: str | Path, content: str | bytes, keep: bool = True) -> Path | None:
    """Writes a file beside its place, syncs it and puts it there.

    Args:
        path: Where it goes; a link is followed, what is no ordinary file (a terminal, a pipe) is written to.
        content: Text is written as UTF-8; signs that it has no place for, of paths that are no text, as `?`.
        keep: Whether what it replaces is kept, with a tilde behind its name.

    Returns:
        Where the earlier file is kept; None where there was none, or the same.

    Raises:
        OSError: It cannot be written, with its name; what was there is as it was.
    """
    data = content.encode("utf-8", "replace") if isinstance(content, str) else content
    place = Path(path).resolve()
    try:
        if place.exists() and not place.is_file():
            place.write_bytes(data)
            return None
        return _replaced(place, Path(path), data, keep)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from None


def _replaced(place: Path, named: Path, data: bytes, keep: bool) -> Path | None:
    earlier = place.with_name(f"{place.name}~") if keep and place.exists() and place.read_bytes() != data else None
    new = _beside(place, data)
    with _gone_on_failure(new):
        if earlier:
            _copied(place, earlier)
        new.replace(place)
    sync_folder(place.parent)
    return earlier if named.is_symlink() else earlier and named.with_name(earlier.name)


def _beside(place: Path, data: bytes) -> Path:
    """A file with these bytes, on the disk, in the folder of its later place and with the rights of what is there."""
    with NamedTemporaryFile(dir=place.parent, prefix=f".{place.name[:100]}.", suffix=".new", delete=False) as file:
        new = Path(file.name)
        with _gone_on_failure(new):
            new.chmod(place.stat().st_mode & 0o7777 if place.exists() else 0o666 & ~_UMASK)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    return new


def _copied(place: Path, earlier: Path) -> None:
    """A second name for a file, in place of what has that name; a copy where the disk knows no second names."""
    if earlier.exists() and earlier.samefile(place):  # a kill came between two renames; one onto itself does nothing
        return
    second = place.with_name(f".{place.name[:100]}.{os.getpid()}.old")
    second.unlink(missing_ok=True)  # else the copy would go into a file that has another name, too
    with _gone_on_failure(second):
        try:
            os.link(place, second)
        except OSError:
            shutil.copy2(place, second)
        second.replace(earlier)


@contextmanager
def _gone_on_failure(path: Path) -> Iterator[None]:
    """Leaves no half-written file behind, whatever stops the work: a full disk, Ctrl-C."""
    done = False
    try:
        yield
        done = True
    finally:
        if not done:
            with suppress(OSError):
                path.unlink()


def sync_folder(folder: Path) -> None:
    """The names in a folder reach the disk, too; some file systems cannot be asked."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


_UMASK = _umask()
