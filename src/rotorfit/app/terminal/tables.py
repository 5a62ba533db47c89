"""Building blocks of terminal output: tables without frames, titles, indented text, bullets, findings."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from rotorfit.core.finding import Finding

View = Iterator[RenderableType]

_FREE = 10_000
"""Width at which no table is broken."""

COLOURS = {"error": "bold red", "warning": "yellow", "info": "cyan"}
"""Severity to its colour."""


def table(*heads: str, left: Sequence[int] = (0,), gap: int = 2) -> Table:
    """A table without frame; columns are right-aligned, except those in `left`."""
    out = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, gap - 1, 0, 0), header_style="bold")
    for place, head in enumerate(heads):
        text = place in left
        out.add_column(head, justify="left" if text else "right", no_wrap=not text, overflow="fold")
    return out


@dataclass(frozen=True)
class FirstThatFits:
    """The first of some tables that no terminal's width breaks, else the last."""

    tables: Sequence[Table]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yields it."""
        free = options.update_width(_FREE)
        fitting = (one for one in self.tables if Measurement.get(console, free, one).maximum <= options.max_width)
        yield next(fitting, self.tables[-1])


def title(text: str) -> Text:
    """A bold line."""
    return Text(text, style="bold")


def indented(text: str, by: int = 2, style: str = "") -> RenderableType:
    """Text that stays indented when it is wrapped."""
    return Padding(Text(text, style=style), (0, 0, 0, by), expand=False)


def bullets(lines: Iterable[str]) -> View:
    """A bulleted list with hanging indents."""
    for line in lines:
        grid = Table.grid(padding=(0, 1, 0, 0))
        grid.add_row(Text("  -"), Text(line))
        yield grid


def finding_view(finding: Finding) -> View:
    """A finding with its effect and remedy."""
    head = Text(finding.severity, style=COLOURS[finding.severity])
    evidence, *more = finding.evidence.split("\n")  # of several axes
    head.append(f" {finding.code}: {evidence}", style="default")
    yield head
    yield from (indented(line) for line in more)
    yield indented(f"Effect: {finding.effect}.")
    yield indented(f"Try: {finding.remedy}.")


NOTHING = 1e-7
"""Numbers below this are rounding errors, in whatever unit is shown."""


def three_digits(value: float) -> str:
    """Three significant digits without an exponent: 0.0412, 1.55, 152; what is too small to matter is 0."""
    return f"{value:.{max(0, 2 - math.floor(math.log10(value)))}f}" if value > NOTHING else "0"
