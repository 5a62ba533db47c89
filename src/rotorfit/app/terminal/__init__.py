"""Terminal output, one module for each kind of result: text and tables that fit 80 columns."""

import re
from collections.abc import Iterable, Iterator

import click
from rich.console import Console, RenderableType

from rotorfit.core.plain import visible

_COLOUR = re.compile("(\x1b\\[[0-9;]*m)")

_UNBROKEN = 2000  # columns, more than any line has


def show(view: Iterable[RenderableType]) -> None:
    """Prints a view on stdout, wrapped to the terminal's width, and not wrapped in a pipe."""
    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = _UNBROKEN
    for text in _parts(console, view):
        click.echo(text, nl=False)


def text_of(view: Iterable[RenderableType]) -> str:
    """A view as text, as `show` prints it in a pipe."""
    return "".join(_parts(Console(markup=False, highlight=False, emoji=False, width=_UNBROKEN, no_color=True), view))


def _parts(console: Console, view: Iterable[RenderableType]) -> Iterator[str]:
    for part in view:
        with console.capture() as captured:
            console.print(part)
        yield "\n".join(_harmless(line.rstrip()) for line in captured.get().split("\n"))


def _harmless(line: str) -> str:
    """A line with its colours; other control characters, as from names in a file, are escaped."""
    return "".join(part if _COLOUR.fullmatch(part) else visible(part) for part in _COLOUR.split(line))
