"""The server: one process, one user, 127.0.0.1."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import uvicorn

from rotorfit.app.loopback.listener import Loopback
from rotorfit.app.web.routes import Studio
from rotorfit.app.web.workspace import Workspace, WorkspaceError, default_folder


def serve(folder: Path | None, port: int, ready: Callable[[str, Path], None] | None) -> None:
    """Serves a workspace until it is interrupted."""
    workspace = Workspace(folder or default_folder())
    try:
        try:
            loopback = Loopback(port, "studio")
        except OSError as error:
            raise WorkspaceError(f"port {port}: {error.strerror}; choose another with --port, or none") from None
        with loopback:
            studio = Studio(workspace, loopback.gated)
            server = loopback.server(studio.app, 2)
            try:
                with _ended_by_interrupt(server):
                    if ready:
                        ready(loopback.address, workspace.folder)
                    server.run(sockets=[loopback.socket])
            finally:
                studio.close()
    finally:
        workspace.close()


@contextmanager
def _ended_by_interrupt(server: uvicorn.Server) -> Iterator[None]:
    """Ctrl-C also ends a server that is still starting: an exception that is raised there may get lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, server.handle_exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
