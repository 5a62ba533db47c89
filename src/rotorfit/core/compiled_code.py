"""Cache folder of compiled code: numba fails with a traceback if it cannot write to one."""

import os
import tempfile
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def keep_compiled_code() -> None:
    """Points numba to a temporary folder of the user where neither the installation nor the home folder is writable.

    That happens in a shared installation run by a user without a home. Call it before numba is imported: numba reads
    the environment variable once.
    """
    home = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    if "NUMBA_CACHE_DIR" not in os.environ and not any(map(_writable, (PACKAGE / "__pycache__", Path(home) / "numba"))):
        os.environ["NUMBA_CACHE_DIR"] = str(_own_folder())


def _writable(folder: Path) -> bool:
    """Whether a folder can be written to or created."""
    there = next((one for one in (folder, *folder.parents) if os.path.lexists(one)), folder)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def _own_folder() -> Path:
    """Folder that only the user can write to, because numba executes code found there; the same in every run."""
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"rotorfit-compiled-{user}"
    try:
        folder.mkdir(mode=0o700)
    except OSError:
        found = os.lstat(folder) if os.path.lexists(folder) else None
        if found is None or folder.is_symlink() or found.st_uid != user or found.st_mode & 0o077:
            return Path(tempfile.mkdtemp(prefix="rotorfit-compiled-"))
    return folder
