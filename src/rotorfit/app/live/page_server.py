"""The live page: states as they come, on 127.0.0.1, behind the studio's gate. It only shows; nothing can be asked."""

import asyncio
import json
import secrets
import socket
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from importlib import resources
from typing import Any

from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Tracked

KEPT = 3600
"""States that a page which is opened late is shown."""

PERIOD = 0.1
"""Between two looks for something new [s]."""

BEAT = 5.0
"""A page is told that nothing is new at the latest after so long [s]."""

FILES = {"live.js": "text/javascript", "live.css": "text/css"}
UPLOT = {"uPlot.iife.min.js": "text/javascript", "uPlot.min.css": "text/css"}


class LivePage:
    """Serves the page from a thread of its own.

    Args:
        port: To listen on; 0 for any that is free.
        say: Told the address, with the key of this run.

    Raises:
        LinkError: The studio's server is not installed, or the port is taken.
    """

    def __init__(self, port: int, say: Callable[[str], None]) -> None:
        try:
            import uvicorn

            from rotorfit.app.web.gate import Gate, cookie_name
        except ModuleNotFoundError:
            raise LinkError("--page needs the studio's server: pip install 'rotorfit[studio]'") from None
        self._lines: deque[tuple[int, str]] = deque(maxlen=KEPT)
        self._count, self._heard, self._over = 0, 0, False
        self._token = secrets.token_urlsafe(32)
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(("127.0.0.1", port))
        except OSError as error:
            self._listener.close()
            raise LinkError(f"--page {port}: {error.strerror}; choose another port, or none") from None
        self._listener.listen()
        own = self._listener.getsockname()[1]
        self._cookie = cookie_name(own)
        config = uvicorn.Config(
            Gate(self._app(), self._token, own),
            log_level="warning",
            access_log=False,  # the first request holds the token
            server_header=False,
            proxy_headers=False,
            timeout_graceful_shutdown=1,
            lifespan="off",
        )
        self._server = uvicorn.Server(config)
        self.address = f"http://127.0.0.1:{own}/?token={self._token}"
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._listener]}, name="rotorfit-page", daemon=True
        )
        self._thread.start()
        say(f"live page: {self.address}")

    def heard(self, samples: Sequence[Sample], _now: int) -> None:
        """Counts."""
        self._heard += len(samples)

    def state(self, state: Tracked, _now: int) -> None:
        """Keeps a state and its alarms for the pages."""
        for alarm in state.alarms:
            self._add(alarm.to_mapping())
        self._add(state.to_mapping())

    def close(self) -> None:
        """Ends the server; open pages say so."""
        self._over = True
        self._server.should_exit = True
        self._thread.join(5.0)
        self._listener.close()

    def _add(self, mapping: dict[str, Any]) -> None:
        self._count += 1
        self._lines.append((self._count, json.dumps(mapping, allow_nan=False)))

    def _app(self) -> Any:
        from starlette.applications import Starlette
        from starlette.requests import Request
        from starlette.responses import Response, StreamingResponse
        from starlette.routing import Route

        def page(request: Request) -> Response:
            response = Response(_file("live.html"), media_type="text/html")
            if "token" in request.query_params:
                response.set_cookie(self._cookie, self._token, httponly=True, samesite="strict", path="/")
            return response

        def static(request: Request) -> Response:
            name = request.path_params["name"]
            if name in FILES:
                return Response(_file(name), media_type=FILES[name])
            if name in UPLOT:
                vendored = resources.files("rotorfit.reporting") / "uplot" / name
                return Response(vendored.read_bytes(), media_type=UPLOT[name])
            return Response(status_code=404)

        def events(request: Request) -> Response:
            seen = request.headers.get("last-event-id", "0")
            return StreamingResponse(
                self._events(int(seen[:18]) if seen.isdecimal() else 0), media_type="text/event-stream"
            )

        return Starlette(routes=[Route("/", page), Route("/page/{name}", static), Route("/events", events)])

    async def _events(self, seen: int) -> AsyncIterator[str]:
        """Lines after one that the page has seen; a browser that was cut off asks from there."""
        quiet = 0.0
        yield "retry: 1000\n\n"
        while not self._over:
            new = [(number, line) for number, line in list(self._lines) if number > seen]
            if new:
                seen, quiet = new[-1][0], 0.0
                yield "".join(f"id: {number}\ndata: {line}\n\n" for number, line in new)
            elif quiet >= BEAT:
                quiet = 0.0
                yield f"event: beat\ndata: {self._heard}\n\n"
            await asyncio.sleep(PERIOD)
            quiet += PERIOD
        yield "event: over\ndata: over\n\n"


def _file(name: str) -> bytes:
    return (resources.files("rotorfit.app.live") / "page" / name).read_bytes()
