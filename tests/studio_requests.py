"""Requests to the studio as a hostile page would send them: of the right form, with a wrong part here and there."""

import json
import random
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rotorfit.app.web.card_lines import QUANTITIES
from rotorfit.app.web.routes import Studio
from rotorfit.core.card import LIMIT_UNITS
from rotorfit.core.log import Sample
from rotorfit.exports.formats import FORMATS
from rotorfit.files.cards import builtin_card_text, builtin_cards
from rotorfit.flying.recorder import record
from studio_room import bag, client_of

WRONG: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2**63, -(2**63), 1e308, -1e-308, 0.5, "", " ", "x", "\x00", "\ud800", "\u2028",
    "a" * 2000, "a." * 1500, "9" * 5000, "nan", "../../x", "'", '"', "\n[pose]\n", "#", "=", [], {}, [[]], [{}],
    {"": {}}, {"from": []}, {"from": "x", "scale": "y"}, {"value": {}, "unit": []}, ["a"] * 200,
)  # fmt: skip
"""Values that stand where others belong."""

NUMBERS = (
    "0",
    "1",
    "-1",
    "1.5",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "",
    "x",
    "1e400",
    "9" * 400,
    "\x00",
)
"""Cells of a table, ends of a window."""

TOML = (
    "nan",
    "inf",
    "1e308",
    "-0.0",
    "2024-01-01",
    "[]",
    "{}",
    "[[[1]]]",
    "'''\n[[[[\n'''",
    '"\\u0000"',
    "true",
    "9" * 30,
)
"""Values of a card's text."""


class Hostile:
    """A page that sends such requests to a studio; the same ones for the same seed."""

    def __init__(self, studio: Studio, seed: int) -> None:
        self._studio, self._page, self._rng = studio, client_of(studio), random.Random(seed)
        self._kinds: tuple[tuple[Callable[[], tuple[str, str, Any]], int], ...] = (
            (self._view, 10), (self._upload, 2), (self._card, 4), (self._ranges, 2), (self._fit, 1), (self._result, 1),
            (self._remove, 1), (self._odd, 1),
        )  # fmt: skip

    def once(self) -> tuple[str, str, int]:
        """Sends a request and checks the answer: no trace, one line, and a session that can be shown.

        Returns:
            Method, path and status.
        """
        kinds, weights = zip(*self._kinds, strict=True)
        method, path, body = self._rng.choices(kinds, weights)[0]()
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        answer = self._page.request(method, path, content=content if method != "GET" else None)
        told = f"{method} {path[:200]} {content[:500]!r}: {answer.status_code} {answer.text[:500]}"
        assert answer.status_code < 500 or answer.status_code == 507, told
        if answer.status_code >= 400 and answer.content and answer.headers["content-type"] == "application/json":
            line = answer.json()["error"]
            assert line, told
            assert line.isprintable(), told
            assert len(line) < 2000, told
        shown = self._page.get("/api/session")
        assert shown.status_code == 200, told
        if self._rng.random() < 0.02:  # whatever is kept can be read again
            self._studio.workspace._loaded()
            assert not self._studio.workspace.notice, told
        return method, path, answer.status_code

    def _some(self, value: Any) -> Any:
        """A value, or now and then a wrong one in its place or inside of it."""
        if self._rng.random() < 0.85:
            if isinstance(value, dict):
                return {name: self._some(part) for name, part in value.items() if self._rng.random() < 0.97}
            return [self._some(part) for part in value] if isinstance(value, list) else value
        return self._rng.choice(WRONG)

    def _id(self) -> str:
        known = [one.id for one in self._studio.workspace.session.uploads]
        return self._rng.choice(known) if known and self._rng.random() < 0.95 else self._word()

    def _fit_id(self) -> str:
        known = [one.id for one in self._studio.workspace.session.fits]
        return self._rng.choice(known) if known and self._rng.random() < 0.9 else self._word()

    def _word(self) -> str:
        return quote(str(self._rng.choice(WRONG))[:500].encode("utf-8", "replace"), safe="")

    def _seen(self) -> Any:
        return self._some(self._studio.workspace.session.card_revision)

    def _view(self) -> tuple[str, str, Any]:
        log, rng = self._id(), self._rng
        kind = rng.choice(("", "/flight", "/findings", "/motion", "/column"))
        query = {name: quote(rng.choice(NUMBERS)) for name in ("from", "to", "width") if rng.random() < 0.3}
        if kind == "/motion":
            query["axis"] = rng.choice(("x", "y", "z", "yaw", "x", self._word()))
        if kind == "/column":
            query["source"] = rng.choice((quote(self._source()), quote(self._source()), self._word()))
        return "GET", f"/api/logs/{log}{kind}?{'&'.join(f'{name}={value}' for name, value in query.items())}", None

    def _source(self) -> str:
        uploads = self._studio.workspace.session.uploads
        if not uploads:
            return "x"
        log = self._studio.shelf.log(self._rng.choice(uploads))
        table = self._rng.choice(list(log.tables.values()))
        column = self._rng.choice(list(table.columns))
        return self._rng.choice((f"{table.name}:{column}", column, f"{column}[0]"))

    def _upload(self) -> tuple[str, str, Any]:
        if len(self._studio.workspace.session.uploads) > 8:
            return self._remove()
        rng = self._rng
        content = rng.choice((self._table, self._table, self._carrying, self._flight))()
        name = self._word() if rng.random() < 0.3 else "log.csv"
        return "POST", f"/api/logs?name={name}", content

    def _table(self) -> bytes:
        rng = self._rng
        heads = ["time", "x", "y", "z", "yaw", "cmd_x", "cmd_y", "cmd_z", "cmd_yaw"]
        heads = [head if rng.random() < 0.95 else json.dumps(str(rng.choice(WRONG)))[:300] for head in heads]
        step, count, spoilt = rng.choice((0.01, 0.05, 0, -0.1, 1e9)), rng.choice((0, 1, 2, 30, 600)), rng.random() < 0.4
        rows = [
            [f"{step * i:.4f}", *(f"{rng.gauss(0, 1):.4f}" for _ in heads[1:])] for i in range(count)
        ]  # fmt: skip
        for row in rows:
            if spoilt and rng.random() < 0.05:
                row[rng.randrange(len(row))] = rng.choice(NUMBERS[:-1])
        return "\n".join(map(",".join, [heads, *rows])).encode("utf-8", "replace") + b"\n"

    def _carrying(self) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "log.mcap"
            recorder = record(path, {"card": self._text().encode("utf-8", "replace").decode()})
            for k in range(self._rng.choice((2, 200))):
                value = [float(self._rng.choice(NUMBERS[:10])) if self._rng.random() < 0.02 else 0.1 for _ in range(11)]
                recorder.command(2 * 10**7 * k, tuple(value[:4]))  # type: ignore[arg-type]
                recorder.sample(Sample("pose", 2 * 10**7 * k, 2 * 10**7 * k, tuple(value[4:])))
            recorder.close()
            return path.read_bytes()

    def _flight(self) -> bytes:
        content = bytearray(bag(self._rng.choice((1, 2)), 5.0))
        for _ in range(self._rng.choice((0, 0, 1, 5))):
            content[self._rng.randrange(len(content))] = self._rng.randrange(256)
        return bytes(content)

    def _text(self) -> str:
        """Of a card, with a few lines that are wrong, gone or doubled."""
        rng = self._rng
        lines = builtin_card_text(rng.choice(("rotorfit-demo", *builtin_cards()))).splitlines()
        for _ in range(rng.choice((0, 1, 1, 3))):
            at = rng.randrange(len(lines))
            name, equals, value = lines[at].partition("=")
            match rng.randrange(5):
                case 0:
                    del lines[at]
                case 1:
                    lines.insert(at, lines[at])
                case 2 if equals:
                    lines[at] = f"{name}= {rng.choice(TOML)} # why"
                case 3:
                    lines[at] = str(rng.choice(WRONG))
                case _:
                    lines[at] = f"{name}{equals}{value}"[: rng.randrange(1 + len(lines[at]))]
        return "\n".join(lines or [""]) + "\n"

    def _card(self) -> tuple[str, str, Any]:
        rng = self._rng
        section, key, _, units = rng.choice(QUANTITIES)
        value: Any = {"from": self._source(), "scale": -1, "unit": rng.choice(units or ("m",))}
        if rng.random() < 0.2:
            section, key, value = "limits", rng.choice(list(LIMIT_UNITS)), {"value": 10, "unit": "deg"}
        kinds = ({"text": self._text()}, {"builtin": rng.choice(list(builtin_cards()))}, {"draft": self._id()})
        edits = {"edits": [{"section": section, "key": key, "value": value}]}
        return "PUT", "/api/card", self._some({**rng.choice((*kinds, edits, edits, edits)), "seen": self._seen()})

    def _ranges(self) -> tuple[str, str, Any]:
        log = self._id()
        seen = next((one.revision for one in self._studio.workspace.session.uploads if one.id == log), 0)
        parts = [{"role": self._rng.choice(("train", "validate")), "start": 1, "end": 4}] * self._rng.randrange(4)
        return "PUT", f"/api/logs/{log}/ranges", self._some({"ranges": parts, "seen": seen})

    def _fit(self) -> tuple[str, str, Any]:
        if len(self._studio.workspace.session.fits) > 8:
            return "DELETE", f"/api/fits/{self._fit_id()}", {}
        if self._rng.random() < 0.2:
            return "POST", f"/api/fits/{self._fit_id()}/cancel", {}
        asked = {"method": "ml", "structure": "averaged", "axes": ["x", "y"], "uncertainty": False}
        return "POST", "/api/fits", self._some(self._rng.choice((asked, {"compare": ["1", "2"]})))

    def _result(self) -> tuple[str, str, Any]:
        file = self._rng.choice(
            ("model.json", "result.json", f"exports/{self._rng.choice(list(FORMATS))}", self._word())
        )
        return "GET", f"/api/fits/{self._fit_id()}/{file}", None

    def _remove(self) -> tuple[str, str, Any]:
        return "DELETE", f"/api/logs/{self._id()}", {}

    def _odd(self) -> tuple[str, str, Any]:
        rng = self._rng
        body = rng.choice(
            (b"", b"{", b"[" * 9999, b'{"a":' * 999, b"\xff", b"1e999", b'{"seen": 1e999}', b"{}" * 9, b"NaN")
        )
        path = rng.choice(
            ("/api/card", "/api/fits", "/api/logs/1/ranges", "/", "/api/session?seen=x", f"/page/{self._word()}")
        )
        return rng.choice(("GET", "PUT", "POST", "DELETE", "PATCH", "HEAD")), path, body
