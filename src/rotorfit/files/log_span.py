"""The requested part of a log: `LOG@T0:T1`."""

import math
from dataclasses import dataclass

from rotorfit.core.errors import LogError
from rotorfit.files.logs.several import is_there, parts_of

Span = tuple[float | None, float | None]

WHOLE: Span = (None, None)


@dataclass(frozen=True)
class LogSpan:
    """A log and its requested part, in seconds of its common window; None for an open end."""

    path: str
    span: Span


def parse_span(text: str) -> Span:
    """Parses `T0:T1` in seconds; either side may be empty.

    Raises:
        LogError: Not of that form, not finite, negative, or T0 is not before T1.
    """
    start, colon, end = text.partition(":")
    try:
        if not colon:
            raise ValueError
        low, high = (float(part) if part.strip() else None for part in (start, end))
        if not all(end is None or math.isfinite(end) for end in (low, high)):
            raise ValueError
    except ValueError:
        raise LogError(f"span {text[:80]!r} is not T0:T1 in seconds, such as 10:60 or :84") from None
    if any(end is not None and end < 0 for end in (low, high)):
        raise LogError(f"span {text!r} reaches back before 0, where poses and commands begin; give T0:T1 from 0 on")
    if low is not None and high is not None and low >= high:
        raise LogError(f"span {text!r} ends before it starts; give T0:T1 with T0 < T1")
    return low, high


def parse_log(text: str, default: Span = WHOLE) -> LogSpan:
    """Parses `LOG` or `LOG@T0:T1`; if a file has the whole text as its name, that file is meant.

    Raises:
        LogError: The text after the `@` of an existing file is not a span.
    """
    name, at, span = text.rpartition("@")
    meant = ":" in span or all(map(is_there, parts_of(name)))
    if at and meant and not is_there(text):
        return LogSpan(name, parse_span(span))
    return LogSpan(text, default)
