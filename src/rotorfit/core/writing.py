"""Atomic writing: after a full disk, a kill or a power failure a file is either the old one or the new one, whole."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryFile

from rotorfit.core.errors import LogError


def write_whole(path: str | Path, content: str | bytes, keep: bool = True) -> Path | None:
    """Writes a temporary file beside the target, syncs it, and moves it into place.

    Args:
        path: Target; a symbolic link is followed; anything but a regular file (a terminal, a pipe) is written directly.
        content: Text is written as UTF-8; lone surrogates, from paths that are not text, become `?`.
        keep: Whether a replaced file is kept, with a tilde after its name.

    Returns:
        Path of the kept earlier file; None where there was none, or its content was the same.

    Raises:
        OSError: It cannot be written; the error names the file, and the earlier content is unchanged.
    """
    data = content.encode("utf-8", "replace") if isinstance(content, str) else content
    named = Path(path)
    try:
        if named.exists() and not named.is_file():  # unresolved: /dev/stdout leads to a name of no file
            named.write_bytes(data)
            return None
        return _replaced(named.resolve(), named, data, keep)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from None


def write_result(path: str | Path, content: str | bytes) -> Path | None:
    """Writes a file that the user has named, as `write_whole` does.

    Raises:
        LogError: Its folder is missing, or it is a folder itself.
        OSError: As `write_whole`.
    """
    check_folder(Path(path))
    return write_whole(path, content)


def check_folder(path: Path) -> None:
    """Refuses a path whose folder is missing, or that is one.

    Raises:
        LogError: There is no such folder, or no file can have its name.
    """
    if not path.resolve().parent.is_dir():
        raise LogError(f"{path}: there is no folder {path.parent}; make it first")
    if path.is_dir():
        raise LogError(f"{path} is a folder; name a file in it")


def check_place(path: Path) -> None:
    """Refuses a path at which no file can be made, before the work for it begins; nothing is left there.

    Raises:
        LogError: Its folder is missing, or takes no file.
    """
    check_folder(path)
    try:
        with TemporaryFile(dir=path.resolve().parent):
            pass
    except OSError as error:
        raise LogError(
            f"{path}: cannot be written ({error.strerror}); check the folder and its permissions, or name another place"
        ) from None


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
    """A synced file with these bytes in the folder of the target, with the permissions of the file it will replace."""
    with NamedTemporaryFile(dir=place.parent, prefix=f".{place.name[:100]}.", suffix=".new", delete=False) as file:
        new = Path(file.name)
        with _gone_on_failure(new):
            new.chmod(place.stat().st_mode & 0o7777 if place.exists() else 0o666 & ~_UMASK)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    return new


def _copied(place: Path, earlier: Path) -> None:
    """Hard-links a file under a second name, replacing what is there; copies it where links are unsupported."""
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
    """Removes a half-written file, whatever interrupts the work: a full disk, Ctrl-C."""
    done = False
    try:
        yield
        done = True
    finally:
        if not done:
            with suppress(OSError):
                path.unlink()


def sync_folder(folder: Path) -> None:
    """Syncs the names in a folder to the disk; file systems that do not support it are ignored."""
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
