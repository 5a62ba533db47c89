"""The server: one process, one user, 127.0.0.1."""

import secrets
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import uvicorn

from rotorfit.app.web.routes import Studio
from rotorfit.app.web.workspace import Workspace, WorkspaceError, default_folder


def serve(folder: Path | None, port: int, ready: Callable[[str, Path], None] | None) -> None:
    """Serves a workspace until it is interrupted."""
    workspace = Workspace(folder or default_folder())
    try:
        # The protocol is named because asyncio turns off waiting for full packets only where it is: 40 ms an answer.
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind(("127.0.0.1", port))
            except OSError as error:
                raise WorkspaceError(f"port {port}: {error.strerror}; choose another with --port, or none") from None
            listener.listen()  # from here on the address answers
            own, token = listener.getsockname()[1], secrets.token_urlsafe(32)
            studio = Studio(workspace, token, own)
            config = uvicorn.Config(
                studio.app,
                log_level="warning",
                access_log=False,  # the first request holds the token
                server_header=False,
                proxy_headers=False,
                timeout_graceful_shutdown=2,
                lifespan="off",
            )
            server = uvicorn.Server(config)
            try:
                with _ended_by_interrupt(server):
                    if ready:
                        ready(f"http://127.0.0.1:{own}/?token={token}", workspace.folder)
                    server.run(sockets=[listener])
            finally:
                studio.runner.close()
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
