"""The feed of a live page: states and alarms as they come, as server-sent events. A page only looks."""

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Callable
from typing import Any

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from rotorfit.app.loopback.files import file_of, static
from rotorfit.app.loopback.gate import FRAMED

KEPT = 3600
"""States that a page which is opened late is shown."""

PERIOD = 0.1
"""Between two looks for something new [s]."""

BEAT = 5.0
"""A page is told that nothing is new at the latest after so long [s]."""

PACKAGE = "rotorfit.app.live"
"""Where the page lies."""


class Feed:
    """What pages are shown. One thread adds, the server reads.

    Args:
        vehicle: What is followed, for people; empty where nothing is.

    Attributes:
        over: Whether nothing more will come; pages that are open say so.
    """

    def __init__(self, vehicle: str = "") -> None:
        self.over = False
        self._vehicle = json.dumps(vehicle)
        self._lines: deque[tuple[int, str]] = deque(maxlen=KEPT)
        self._count = 0

    def add(self, mapping: dict[str, Any]) -> None:
        """A state, an alarm or new gains, as `rotorfit track --jsonl` prints it."""
        self._count += 1
        self._lines.append((self._count, json.dumps(mapping, allow_nan=False)))

    async def events(self, seen: int) -> AsyncIterator[str]:
        """Lines after one that the page has seen; a browser that was cut off asks from there."""
        quiet = 0.0
        yield f"retry: 1000\n\nevent: vehicle\ndata: {self._vehicle}\n\n"
        while True:
            over = self.over
            new = [(number, line) for number, line in list(self._lines) if number > seen]
            if new:
                seen, quiet = new[-1][0], 0.0
                yield "".join(f"id: {number}\ndata: {line}\n\n" for number, line in new)
            elif quiet >= BEAT:
                quiet = 0.0
                yield "event: beat\ndata: nothing new\n\n"
            if over:
                break
            await asyncio.sleep(PERIOD)
            quiet += PERIOD
        yield "event: over\ndata: over\n\n"


def live_routes(feed: Callable[[], Feed], under: str = "") -> list[Route]:
    """The page, its files and its events.

    Args:
        feed: The feed as it is now.
        under: Where they stand; empty for the root.
    """

    def page(_: Request) -> Response:
        response = file_of(PACKAGE, "live.html")
        response.headers["content-security-policy"] = FRAMED
        response.headers["x-frame-options"] = "SAMEORIGIN"
        return response

    def events(request: Request) -> Response:
        seen = request.headers.get("last-event-id", "0")
        lines = feed().events(int(seen[:18]) if seen.isdecimal() else 0)
        return StreamingResponse(lines, media_type="text/event-stream")

    return [
        Route(f"{under}/", page),
        Route(f"{under}/page/{{name}}", static(PACKAGE)),
        Route(f"{under}/events", events),
    ]
