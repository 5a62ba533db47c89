"""Where compiled code is kept: numba, which must keep it, ends in a trace where it may write nowhere."""

import os
import tempfile
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def keep_compiled_code() -> None:
    """Gives numba a folder of the user's own for temporary files where neither installation nor home can be written.

    That is so in an installation of somebody else's without a home. Before numba is imported: it looks once.
    """
    home = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    if "NUMBA_CACHE_DIR" not in os.environ and not any(map(_writable, (PACKAGE / "__pycache__", Path(home) / "numba"))):
        os.environ["NUMBA_CACHE_DIR"] = str(_own_folder())


def _writable(folder: Path) -> bool:
    """Whether a folder can be written to, or made."""
    there = next((one for one in (folder, *folder.parents) if os.path.lexists(one)), folder)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _own_folder() -> Path:
    """A folder that nobody else can write to, for compiled code that is found there is run: the same in every run."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"rotorfit-compiled-{user}"
    try:
        folder.mkdir(mode=0o700)
    except OSError:
        found = os.lstat(folder) if os.path.lexists(folder) else None
        if found is None or folder.is_symlink() or found.st_uid != user or found.st_mode & 0o077:
            return Path(tempfile.mkdtemp(prefix="rotorfit-compiled-"))
    return folder
