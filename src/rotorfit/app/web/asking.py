"""Checks what a page requests: ranges, changes of the card, fits, windows. All else is refused in one line."""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, cast

from rotorfit.app.web.card_lines import card_from_text, with_value
from rotorfit.app.web.workspace import Range, Role, Session, Upload
from rotorfit.core.errors import RotorfitError
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import AVERAGED, STRUCTURES
from rotorfit.estimation.methods import BEST, METHODS
from rotorfit.files.cards import builtin_card_text
from rotorfit.flying.links.opening import check_listens, split

MOST_RANGES = 50

LONGEST_CARD = 100_000

SESSION_CARD = "session"
"""Stands for the session's own card in place of a name."""

WIDEST = 4096
"""Largest width of a plot [pixels]."""


class RequestError(RotorfitError):
    """A request that is not valid: from another version of the page, or written by hand."""


def ranges_from(body: Any) -> tuple[tuple[Range, ...], int]:
    """Ranges, and the revision that the page has seen: `{"ranges": [{"role", "start", "end"}], "seen"}`."""
    parts = _field(body, "ranges", list)
    if len(parts) > MOST_RANGES:
        raise RequestError(f"at most {MOST_RANGES} ranges a log")
    return tuple(_range(part) for part in parts), _field(body, "seen", int)


def check_inside(ranges: Iterable[Range], span: tuple[float, float], name: str) -> None:
    """Refuses a range that holds nothing of the flight of the log `name`, whose span is given [s]."""
    first, last = span
    for part in ranges:
        start, end = first if part.start is None else part.start, last if part.end is None else part.end
        if not max(start, first) < min(end, last):
            raise RequestError(
                f"{name}: the range {part.words} holds nothing of the flight, {first:.2f} to {last:.2f} s; "
                "mark a part of that"
            )


def _range(part: Any) -> Range:
    role = _field(part, "role", str)
    if role not in ("train", "validate"):
        raise RequestError(f"a range is for train or validate, not {role[:20]!r}")
    start, end = (_second(part.get(name)) for name in ("start", "end"))
    if start is not None and end is not None and start >= end:
        raise RequestError(f"a range from {start:g} to {end:g} s is empty; it must end after it starts")
    return Range(cast("Role", role), start, end)


def _second(value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise RequestError("the ends of a range are seconds")
    return float(value)


def edits_from(body: Any, drafted: Callable[[str], str]) -> tuple[Callable[[str], str], int]:
    """The change of the card's text, and the revision that the page has seen.

    One of `{"text"}`, `{"builtin": NAME}`, `{"draft": LOG}` and `{"edits": [{"section", "key", "value"}]}`.
    """
    seen = _field(body, "seen", int)
    if "text" in body:
        text = _field(body, "text", str)
        if len(text) > LONGEST_CARD:
            raise RequestError(f"a card holds at most {LONGEST_CARD} characters")
        return lambda _: text, seen
    if "builtin" in body:
        text = builtin_card_text(_field(body, "builtin", str))
        return lambda _: text, seen
    if "draft" in body:
        text = drafted(_field(body, "draft", str))
        return lambda _: text, seen
    edits = [(_field(e, "section", str), _field(e, "key", str), e.get("value")) for e in _field(body, "edits", list)]

    def change(text: str) -> str:
        for section, key, value in edits:
            text = with_value(text, section, key, value)
        return text

    return change, seen


def fit_request(
    body: Any, session: Session, path_of: Callable[[Upload], str]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """The request for the worker, and the ranges of the logs in words."""
    names = {path_of(upload): upload.name for upload in session.uploads}
    spans: dict[str, list[tuple[str, float | None, float | None]]] = {"train": [], "validate": []}
    for upload in session.uploads:
        for part in upload.ranges:
            spans[part.role].append((path_of(upload), part.start, part.end))
    if "compare" in body:
        models = _field(body, "compare", list)
        done = [fit.id for fit in session.fits if fit.status == "done" and fit.settings.get("kind") == "fit"]
        if not models or not set(map(str, models)) <= set(done):
            raise RequestError("choose models among the fits that are done")
        if not spans["validate"]:
            raise RequestError(
                "mark a stretch for validation first: models are compared on flights that none was fitted to"
            )
        return {
            "kind": "compare",
            "models": list(dict.fromkeys(map(str, models))),
            **spans,
            "names": names,
        }, session.marked
    if not session.card:
        raise RequestError("there is no card yet; draft one on the page Card")
    card_from_text(session.card)
    if not spans["train"]:
        raise RequestError("mark a stretch for training first, on the page Ranges")
    method, structure = _one_of(body, "method", tuple(METHODS), BEST), _one_of(
        body, "structure", (AVERAGED, "auto", *STRUCTURES), AVERAGED
    )  # fmt: skip
    wanted = body.get("axes", AXES)
    axes = [axis for axis in AXES if isinstance(wanted, list | tuple) and axis in wanted]
    if not axes:
        raise RequestError("choose at least one axis to fit")
    uncertainty = bool(body.get("uncertainty")) and METHODS[method].likelihood
    settings = {"method": method, "structure": structure, "axes": axes, "uncertainty": uncertainty}
    settings |= {"card_revision": session.card_revision, "card_sha256": session.card_sha256}
    return {"kind": "fit", **settings, **spans, "names": names}, session.marked


def live_request(body: Any, session: Session) -> tuple[str, str, bool]:
    """Link, card, and whether that is a text: `{"link", "card"}`, a name, `""` for none, `"session"` for the session's.

    Raises:
        LinkError: No such link, or one that nobody can listen to.
    """
    link, card = _field(body, "link", str).strip(), _field(body, "card", str)
    check_listens(link)
    if split(link)[0] == "replay":
        raise RequestError("a log is not live; add it on the page Logs")
    if card and card != SESSION_CARD:
        builtin_card_text(card)
    if card == SESSION_CARD and not session.card:
        raise RequestError("there is no card yet; draft one on the page Card")
    return link, session.card if card == SESSION_CARD else card, card == SESSION_CARD


def _one_of(body: Mapping[str, Any], name: str, known: tuple[str, ...], otherwise: str) -> str:
    value = body.get(name, otherwise)
    if value not in known:
        raise RequestError(f"{name} is one of {', '.join(known)}")
    return str(value)


def window_from(query: Mapping[str, str], time: Array) -> tuple[float, float, int]:
    """Start and end [s] and width [pixels] of a window; the whole series if none is given."""
    try:
        start, end = (float(query[name]) if name in query else None for name in ("from", "to"))
        width = int(query.get("width", "800"))
    except ValueError:
        raise RequestError("a window is from, to (seconds) and width (pixels)") from None
    first, last = (float(time[0]), float(time[-1])) if time.size else (0.0, 0.0)
    start, end = first if start is None else start, last if end is None else end
    if not (math.isfinite(start) and math.isfinite(end) and start <= end):
        raise RequestError("a window ends after it starts")
    return start, end, min(max(width, 1), WIDEST)


def _field(body: Any, name: str, kind: type) -> Any:
    value = body.get(name) if isinstance(body, dict) else None
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise RequestError(f"the request lacks {name!r}")
    return value
