"""The studio: a local web page, from dropped logs to a validated model. Loopback only, with a new secret every run."""

from collections.abc import Callable
from pathlib import Path

from rotorfit.core.errors import RotorfitError


class StudioError(RotorfitError):
    """The studio cannot start: a package is missing, or the port is taken."""


def studio(folder: str | Path | None = None, port: int = 0, ready: Callable[[str, Path], None] | None = None) -> None:
    """Serves the studio on 127.0.0.1 until it is interrupted.

    Args:
        folder: Folder of the session, a new one or that of an earlier run; None for the user's own.
        port: Port to listen on; 0 for any free one.
        ready: Called with the address to open, which holds the secret of this run, and the folder.

    Raises:
        StudioError: starlette or uvicorn is missing, or the port is taken.
        WorkspaceError: The folder cannot be used: in use, damaged, or full of other things.
    """
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
    except ModuleNotFoundError as error:
        raise StudioError(f"{error.name} is not installed; install it with: pip install 'rotorfit[studio]'") from None
    from rotorfit.app.web.server import serve

    serve(None if folder is None else Path(folder), port, ready)
