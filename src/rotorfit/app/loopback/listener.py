"""A listener on 127.0.0.1 with a key for this run, and its server: for the studio and for the live page."""

import secrets
import socket
from types import TracebackType

import uvicorn
from starlette.types import ASGIApp

from rotorfit.app.loopback.gate import Gate


class Loopback:
    """A listening socket, and the secret that grants access.

    Args:
        port: Port to listen on; 0 for any free one.
        verb: Verb of the command line that prints the address.

    Raises:
        OSError: The port is taken.
    """

    def __init__(self, port: int, verb: str) -> None:
        self._verb, self.token = verb, secrets.token_urlsafe(32)
        # Naming the protocol makes asyncio disable Nagle's algorithm, which would cost 40 ms an answer.
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self.socket.bind(("127.0.0.1", port))
        except OSError:
            self.socket.close()
            raise
        self.socket.listen()  # from here on the address answers
        self.port: int = self.socket.getsockname()[1]

    def __enter__(self) -> "Loopback":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.socket.close()

    @property
    def address(self) -> str:
        """The address to open in a browser, including the key."""
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    def gated(self, app: ASGIApp) -> Gate:
        """An application behind the gate."""
        return Gate(app, self.token, self.port, self._verb)

    def server(self, app: ASGIApp, patience: int) -> uvicorn.Server:
        """A server to run on the socket.

        Args:
            app: The application, which is put behind the gate.
            patience: How long it waits for open answers at the end [s].
        """
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,  # the first request holds the token
            server_header=False,
            proxy_headers=False,
            timeout_graceful_shutdown=patience,
            lifespan="off",
        )
        return uvicorn.Server(config)
