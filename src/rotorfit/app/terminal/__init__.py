"""What the terminal shows, a module a noun: text and tables that fit 80 columns."""

from collections.abc import Iterable

import click
from rich.console import Console, RenderableType

_UNBROKEN = 2000  # columns: more than any line has


def show(view: Iterable[RenderableType]) -> None:
    """Prints a view on stdout: as wide as the terminal, and without broken lines in a pipe."""
    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = _UNBROKEN
    for part in view:
        with console.capture() as captured:
            console.print(part)
        click.echo("\n".join(line.rstrip() for line in captured.get().split("\n")), nl=False)
