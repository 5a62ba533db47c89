"""The table of coefficients, ready to print: numbers with the digits that they deserve, and a bar for each interval."""

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from rotorfit.evidence import CoefficientRow, coefficient_rows
from rotorfit.model import STRUCTURE, Model
from rotorfit.report.words import rounded, term_of
from rotorfit.structure import structure_named


@dataclass(frozen=True)
class Bar:
    """Places of an interval, its estimate and the paper's value along a bar of 100."""

    low: float
    high: float
    value: float | None
    paper: float | None


@dataclass(frozen=True)
class RowText:
    """A row of the table of coefficients, ready to print; `kind` is `ok`, `missing`, `bad` or `combination`."""

    term: str
    symbol: str
    value: str
    stderr: str
    interval: str
    unit: str
    status: str
    paper: str
    kind: str
    bar: Bar | None
    told: str


def coefficient_table(model: Model) -> list[tuple[str, list[RowText]]]:
    """Rows of the table of coefficients, axis by axis."""
    rows = groupby(coefficient_rows(model), key=lambda row: row.axis)
    return [(axis, [_row_text(row) for row in group]) for axis, group in rows]


def laws_of(model: Model) -> list[tuple[str, str]]:
    """Axes that have another structure than the default, and its law."""
    known = {name: axis.structure for name, axis in model.axes.items() if axis.structure != STRUCTURE}
    return [(name, structure_named(structure).law) for name, structure in known.items()]


def _row_text(row: CoefficientRow) -> RowText:
    width = None if row.low is None or row.high is None else (row.high - row.low) / 4
    scale = row.stderr or width
    ends = [rounded(end, scale) if end is not None else "open" for end in (row.low, row.high)]
    known = row.low is not None or row.high is not None
    interval = f"{ends[0]} to {ends[1]}" if known else "—"
    kind = {"ok": "ok", "diverged": "bad"}.get(row.status, "missing")
    if row.name in ("steady_gain", "total_lag", "offset_plus_delay"):
        kind = "combination"
    paper = rounded(row.paper, scale)
    told = f"{term_of(row.name)}: estimate {rounded(row.value, scale)}, 95 % interval {interval}, paper's {paper}"
    return RowText(
        term=term_of(row.name),
        symbol=row.symbol,
        value=rounded(row.value, scale),
        stderr=rounded(row.stderr, row.stderr),
        interval=interval,
        unit=row.unit,
        status=row.status.replace("_", " "),
        paper=paper,
        kind=kind,
        bar=_bar(row),
        told=told,
    )


def _bar(row: CoefficientRow) -> Bar | None:
    """Where the interval lies; an open end runs to the border. The paper's value sits at the border if beyond it."""
    if row.low is None and row.high is None:
        return None
    finite = [end for end in (row.low, row.high, row.value) if end is not None]
    low, high = min(finite), max(finite)
    pad = 1.2 * (high - low) or abs(high) or 1.0
    if row.paper is not None:  # as far as twice the interval's width
        low, high = min(low, max(row.paper, low - 2 * pad)), max(high, min(row.paper, high + 2 * pad))
    low, high = low - 0.15 * pad, high + 0.15 * pad

    def place(value: float) -> float:
        return round(float(np.clip(100 * (value - low) / (high - low), 3, 97)), 1)

    return Bar(
        3.0 if row.low is None else place(row.low),
        97.0 if row.high is None else place(row.high),
        None if row.value is None else place(row.value),
        None if row.paper is None else place(row.paper),
    )
