"""A file in the place of another."""

from pathlib import Path

from rotorfit.files.kinds import text_kind, told_instead
from rotorfit.files.logs import HEAD, format_of


def mistaken(path: str | Path, wanted: str) -> str:
    """What a file is where it is of another kind than the wanted one, in one line with what takes it.

    Args:
        path: A file, which need not exist.
        wanted: A name in `kinds.KINDS`.

    Returns:
        The line; empty where the file is of the wanted kind, or of none that is known.
    """
    found = kind_of(Path(path))
    return "" if found in ("", wanted) else told_instead(path, found, wanted)


def kind_of(path: Path) -> str:
    """The name in `kinds.KINDS` of what a file is; empty where that is not known or the file cannot be read."""
    head = b""
    try:
        if path.is_file():
            with path.open("rb") as file:
                head = file.read(HEAD)
        elif not path.is_dir():
            return ""
        return text_kind(head) or ("log" if format_of(path, head) else "")
    except (OSError, ValueError):
        return ""
