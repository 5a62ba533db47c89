"""The server: one process, one user, 127.0.0.1."""

import secrets
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import uvicorn

from rotorfit.studio.routes import Studio
from rotorfit.studio.workspace import Workspace, WorkspaceError, default_folder


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
            try:
                with suppress(KeyboardInterrupt):  # the way to end it
                    if ready:
                        ready(f"http://127.0.0.1:{own}/?token={token}", workspace.folder)
                    uvicorn.Server(config).run(sockets=[listener])
            finally:
                studio.runner.close()
    finally:
        workspace.close()
