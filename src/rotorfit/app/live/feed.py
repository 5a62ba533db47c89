"""The feed of a live page: states and alarms as they come, as server-sent events. A page only reads."""

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
"""Number of past states that a page gets when it is opened late, and of past alarms and gains."""

PERIOD = 0.1
"""Time between two checks for new lines [s]."""

BEAT = 5.0
"""Longest time without an event; then a keep-alive is sent [s]."""

PACKAGE = "rotorfit.app.live"
"""Package with the files of the page."""


class Feed:
    """The lines that pages show. One thread adds, the server reads.

    Args:
        vehicle: Name of the tracked vehicle for the user; empty if there is none.

    Attributes:
        over: Whether nothing more will come; open pages then say so.
    """

    def __init__(self, vehicle: str = "") -> None:
        self.over = False
        self._vehicle = json.dumps(vehicle)
        self._states, self._others = (deque[tuple[int, str]](maxlen=KEPT) for _ in range(2))
        self._count = 0

    def add(self, mapping: dict[str, Any]) -> None:
        """Adds a state, an alarm or new gains, as `rotorfit track --jsonl` prints it."""
        lines = self._states if mapping["type"] == "state" else self._others  # no state pushes an alarm out
        lines.append((self._count + 1, json.dumps(mapping, allow_nan=False)))
        self._count += 1  # only now: who reads meanwhile leaves out none

    async def events(self, seen: int) -> AsyncIterator[str]:
        """Events after the last line that the page has seen; a browser that was disconnected resumes from there."""
        quiet = 0.0
        yield f"retry: 1000\n\nevent: vehicle\ndata: {self._vehicle}\n\n"
        while True:
            over, count = self.over, self._count
            new = sorted(one for one in (*self._states, *self._others) if seen < one[0] <= count)
            if new:
                seen, quiet = count, 0.0
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
        feed: Returns the current feed.
        under: Path prefix of the routes; empty for the root.
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
