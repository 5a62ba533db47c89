"""The gate: checks every request before it is served, and refuses those that are not clearly the user's own.

The studio and the live page listen on the loopback interface only, but every web page that the user has open can send
requests there. So a request needs the secret of this run, must name this server as its host (against DNS rebinding),
and must not come from another page.
"""

from hmac import compare_digest
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOSTS = ("127.0.0.1", "localhost")
"""Names by which this machine may be addressed."""

_OWN_FILES = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors "
)

POLICY, FRAMED = f"{_OWN_FILES}'none'", f"{_OWN_FILES}'self'"
"""Content policy of our pages, which may load their own files only; and of those that may be framed by another one."""

SANDBOX = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
"""Policy of pages made from uploads: sandboxed, without the studio's cookie and without network access."""

_SAFE = ("GET", "HEAD")


class Gate:
    """Passes requests that carry the token, name this host, and come from our own page or from no page at all.

    Args:
        app: The application behind the gate.
        token: The secret of this run.
        port: Port of the server.
        verb: Verb of the command line that prints the address: `studio`, `track`.
    """

    def __init__(self, app: ASGIApp, token: str, port: int, verb: str = "studio") -> None:
        self._app, self._token, self._verb = app, token.encode(), verb
        self._cookie = cookie_name(port)
        self._hosts = {f"{host}:{port}" for host in HOSTS} | (set(HOSTS) if port == 80 else set())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serves a request, or refuses it."""
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        if scope["type"] != "http":  # no websockets here
            return await send({"type": "websocket.close", "code": 1008})
        headers = Headers(scope=scope)
        carried = self._carried(scope, headers)
        if refusal := self._refusal(scope, headers, carried):
            return await _guarded(refusal, scope, receive, send)
        kept = f"{self._cookie}={self._token.decode()}; HttpOnly; Path=/; SameSite=strict"
        return await _guarded(self._app, scope, receive, send, kept if carried == "link" else "")

    def _refusal(self, scope: Scope, headers: Headers, carried: str | None) -> Response | None:
        # the first is read by a person, the second by a page
        refuse = self._readable if scope["path"] == "/" else refused
        if [value.lower() for value in headers.getlist("host")] not in [[host] for host in self._hosts]:
            return refuse(403, f"this is not the address of `rotorfit {self._verb}`; open the one that it printed")
        if carried is None:
            line = f"the key of this run is missing or old; open the address that `rotorfit {self._verb}` printed"
            return refuse(401, line)
        if not self._from_here(scope, headers, carried):
            return refuse(403, "requests of other web pages are refused")
        return None

    def _readable(self, status: int, line: str) -> Response:
        """A refusal that a person can read."""
        return PlainTextResponse(f"rotorfit {self._verb}: {line}.\n", status)

    def _carried(self, scope: Scope, headers: Headers) -> str | None:
        """How a request carries the token: `link`, `cookie` or `header`; None if it does not."""
        query = parse_qs(scope["query_string"].decode("latin-1")).get("token", [])
        if scope["path"] == "/" and scope["method"] == "GET" and len(query) == 1 and self._is_token(query[0]):
            return "link"
        kind, _, given = headers.get("authorization", "").partition(" ")
        if kind.lower() == "bearer" and self._is_token(given):
            return "header"
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return None
        return "cookie" if cookie is not None and self._is_token(cookie.value) else None

    def _is_token(self, given: str) -> bool:
        return compare_digest(given.encode("utf-8", "surrogateescape"), self._token)

    def _from_here(self, scope: Scope, headers: Headers, carried: str) -> bool:
        """Whether a request comes from a page of this server, from the user's address bar, or from a program."""
        if carried == "link":
            return True
        origins, sites = headers.getlist("origin"), headers.getlist("sec-fetch-site")
        if any(origin not in {f"http://{host}" for host in self._hosts} for origin in origins):
            return False
        if scope["method"] in _SAFE:
            return set(sites) <= {"same-origin", "none"}
        if set(sites) - {"same-origin"}:
            return False
        return bool(origins or sites) or carried == "header"  # browsers always send one; a program uses the header


def cookie_name(port: int) -> str:
    """Name of the cookie. It has the port, because cookies are shared between the ports of a host."""
    return f"rotorfit-studio-{port}"


def refused(status: int, line: str) -> Response:
    """A refusal as one line of JSON that says what the user can do."""
    return JSONResponse({"error": line}, status)


async def _guarded(app: ASGIApp, scope: Scope, receive: Receive, send: Send, cookie: str = "") -> None:
    """Adds security headers and the cookie to an answer; its own content policy is kept."""

    async def sent(message: Message) -> None:
        """Passes on a part of the answer; its first has the headers."""
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.setdefault("content-security-policy", POLICY)
            headers.setdefault("cache-control", "no-store")
            headers["x-content-type-options"] = "nosniff"
            headers["referrer-policy"] = "no-referrer"
            headers["cross-origin-resource-policy"] = "same-origin"
            headers["cross-origin-opener-policy"] = "same-origin"
            headers.setdefault("x-frame-options", "DENY")
            if cookie:
                headers["set-cookie"] = cookie
        await send(message)

    await app(scope, receive, sent)
