"""How results show themselves: columns as a data frame, rows of text as a table, large values as a short text."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from html import escape
from typing import Any, Literal

import numpy as np

from rotorfit.core.errors import RotorfitError
from rotorfit.core.finding import Finding

FrameLibrary = Literal["polars", "pandas"]

LONG = 120
"""Characters of a value beyond which a short text says only what it is."""


def frame(columns: Mapping[str, Any], library: FrameLibrary = "polars") -> Any:
    """Columns as a data frame.

    Args:
        columns: Name to values, all of one length.
        library: `polars`, or `pandas`, which is imported only then.

    Returns:
        A `polars.DataFrame` or a `pandas.DataFrame`.

    Raises:
        RotorfitError: Another library, or pandas is not installed.
    """
    if library == "polars":
        import polars as pl

        return pl.DataFrame(dict(columns))
    if library != "pandas":
        raise RotorfitError(f"no such library of data frames: {library!r}; known are 'polars' and 'pandas'")
    try:
        import pandas as pd
    except ModuleNotFoundError:
        raise RotorfitError("pandas is not installed; install it with: pip install pandas") from None
    return pd.DataFrame(dict(columns))


def columns_of(heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> dict[str, list[Any]]:
    """Rows as columns; without rows, empty ones."""
    return {head: [row[place] for row in rows] for place, head in enumerate(heads)}


def number(value: float | None) -> str:
    """A number with four digits; `-` where there is none."""
    return "-" if value is None else f"{value:#.4g}".rstrip(".")


def interval(low: float | None, high: float | None) -> str:
    """`3.601 to 3.725`, an open end as `open`; empty where both are."""
    if low is None and high is None:
        return ""
    return " to ".join("open" if end is None else number(end) for end in (low, high))


def text_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A title over aligned columns."""
    widths = [max(len(row[place]) for row in (heads, *rows)) for place in range(len(heads))]
    lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in (heads, *rows))
    return "\n".join([title, *lines]) if rows else title


def html_table(
    title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], findings: Sequence[Finding] = ()
) -> str:
    """The same as HTML, with the findings below; whatever a file says is escaped."""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>"

    table = f"<table>{cells('th', heads)}{''.join(cells('td', row) for row in rows)}</table>" if rows else ""
    found = "".join(f"<li>{each._repr_html_()}</li>" for each in findings)
    return f"<div><p>{escape(title)}</p>{table}{f'<ul>{found}</ul>' if found else ''}</div>"


def short_repr(value: Any) -> str:
    """Text of a dataclass that may hold arrays or long collections: those are only counted."""
    shown = (f"{field.name}={_short(getattr(value, field.name))}" for field in fields(value) if field.repr)
    return f"{type(value).__name__}({', '.join(shown)})"


def _short(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"<{value.dtype} array of shape {value.shape}>"
    if isinstance(value, Mapping | tuple | list) and len(text := _inside(value)) > LONG:
        return f"<{len(value)} {'entries' if isinstance(value, Mapping) else 'items'}>"
    return text if isinstance(value, Mapping | tuple | list) else repr(value)


def _inside(value: Mapping[Any, Any] | Sequence[Any]) -> str:
    """Text of a collection, its arrays counted, as far as it can still be short."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {_short(part)}" for key, part in list(value.items())[:LONG]) + "}"
    return "(" + ", ".join(map(_short, value[:LONG])) + ")"
