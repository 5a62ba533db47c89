"""Arguments and options that several verbs share, the conversion of their texts, JSON output and progress bar."""

import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import click

from rotorfit.app.cli.compiling import COMPILING, compiling_announced
from rotorfit.core.errors import RotorfitError
from rotorfit.core.progress import Progress

Function = TypeVar("Function", bound=Callable[..., Any])

LONGEST_LINE = 2000
"""Largest length of an error message, which may quote values of a file [characters]."""


def span_of(ctx: click.Context, _parameter: click.Parameter, text: str | None) -> Any:
    """`T0:T1` as a Span; the whole log if none is given."""
    from rotorfit.files.log_span import WHOLE, parse_span

    try:
        return WHOLE if text is None else parse_span(text)
    except RotorfitError as error:
        raise click.BadParameter(str(error), ctx) from None


def axes_of(ctx: click.Context, _parameter: click.Parameter, text: str | None) -> Any:
    """Names of axes, separated by commas; all axes if none is given."""
    from rotorfit.core.frames import AXES

    axes = AXES if text is None else tuple(part.strip() for part in text.split(","))
    unknown = [axis for axis in axes if axis not in AXES]
    if unknown:
        raise click.BadParameter(f"no such axis: {', '.join(map(repr, unknown))}; axes are {', '.join(AXES)}", ctx)
    return tuple(axis for axis in AXES if axis in axes)


def some_axes_of(ctx: click.Context, parameter: click.Parameter, text: str | None) -> Any:
    """As `axes_of`, but None if none is given."""
    return None if text is None else axes_of(ctx, parameter, text)


def structure_of(ctx: click.Context, _parameter: click.Parameter, name: str | None) -> Any:
    """Name of a structure, `averaged` or `auto`; `averaged` if none is given."""
    from rotorfit.core.laws import AVERAGED, STRUCTURES

    names = (AVERAGED, "auto", *STRUCTURES)
    if name is not None and name not in names:
        raise click.BadParameter(f"no such structure: {name!r}; structures are {', '.join(names)}", ctx)
    return name or AVERAGED


FARTHEST = 3600.0
"""Longest horizon [s]."""


def horizons_of(ctx: click.Context, _parameter: click.Parameter, text: str | None) -> Any:
    """Horizons [s], separated by commas; those of the protocol if none is given."""
    from rotorfit.core.results import HORIZONS

    try:
        horizons = HORIZONS if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        horizons = ()
    if not horizons or not all(0 < horizon <= FARTHEST for horizon in horizons):
        raise click.BadParameter(f"{text!r} is no list of seconds from 0 to {FARTHEST:g}, such as 0.5,1,2,5", ctx)
    return tuple(dict.fromkeys(horizons))


class Number(click.FloatRange):
    """A finite number within bounds; the error says which, with an example."""

    def __init__(self, low: float, high: float | None, example: float) -> None:
        super().__init__(low, high)
        self._bounds = f"of {low} or more" if high is None else f"from {low} to {high}"
        self._example = example

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number; refuses what is none, or out of bounds."""
        try:
            number: Any = super().convert(value, param, ctx)
        except click.BadParameter:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value} is not a number {self._bounds}, such as {self._example}", param, ctx)
        return number


class Whole(click.IntRange):
    """A whole number within bounds; the error says which."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number; refuses what is none, or out of bounds."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            self.fail(f"{value} is not a whole number from {self.min} to {self.max}", param, ctx)


SEED = Whole(0, (1 << 63) - 1)

PORT = Whole(0, 65535)


class _File(click.Path):
    """A path on the disk; not the option that follows where the path was forgotten."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; refuses what looks like an option."""
        return super().convert(_not_an_option(ctx, param, value), param, ctx)


def _not_an_option(ctx: click.Context | None, parameter: click.Parameter | None, value: Any) -> Any:
    if isinstance(value, str) and value.startswith("-"):
        raise click.BadParameter(
            f"a value is missing before {value} (a file of that name is ./{value})", ctx, parameter
        )
    return value


def file_at(**more: Any) -> click.Path:
    """A path on the disk; `more` as in `click.Path`."""
    return _File(path_type=Path, **more)


LOGS = click.argument("logs", metavar="LOG...", nargs=-1, required=True)

MODEL = click.argument("model_path", metavar="MODEL")


def card_option(default: str, what: str = "Name of a built-in card, or a TOML file") -> Callable[[Function], Function]:
    """The option `--card`; `what` says what it takes, and `default` what is used without it."""
    told = f"{what}; default: {default}."
    return click.option("--card", metavar="C", multiple=True, callback=_one_card, help=told)


def _one_card(ctx: click.Context | None, parameter: click.Parameter | None, values: tuple[str, ...]) -> str | None:
    if len(values) > 1:
        raise click.BadParameter(f"{len(values)} cards are given, and one serves all flights", ctx, parameter)
    return _not_an_option(ctx, parameter, values[0]) if values else None


JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")

SPAN = click.option(
    "--span", metavar="T0:T1", callback=span_of, help="Part of every log [s], from the start of its common window."
)


def gains_name(ctx: click.Context, _parameter: click.Parameter, name: str | None) -> str | None:
    """Checks the name of a gains file, so that a log or plan is not taken for one; empty for messages alone."""
    if name:
        from rotorfit.exports.gains import check_gains_name

        try:
            check_gains_name(Path(name))
        except RotorfitError as error:
            place = next(str(one.metavar) for one in ctx.command.params if isinstance(one, click.Argument))
            raise click.BadParameter(f"{error}, or put --tune behind the {place.strip('[]')}", ctx) from None
    return name


AFTER = click.option(
    "--after",
    type=file_at(dir_okay=False),
    metavar="model.json",
    help="Model of an earlier flight: reported until this flight identifies the vehicle, then compared.",
)

TUNE = click.option(
    "--tune",
    "gains",
    is_flag=False,
    flag_value="",
    callback=gains_name,
    metavar="[gains.toml]",
    help="Publish new gains when those in the file no longer suit the vehicle; sends no commands.",
)


def say_kept(kept: Path | None, lost: Sequence[str] = ()) -> None:
    """Says on stderr where a replaced file is kept, and which axes only that one knew."""
    if kept:
        only = f", which knew {', '.join(lost)}, too," if lost else ""
        click.echo(f"Note: the earlier {kept.name[:-1]}{only} is kept as {kept}.", err=True)


def print_json(result: Any) -> None:
    """Prints a result as JSON; NaN in it is a bug and raises."""
    click.echo(json.dumps(result, indent=1, allow_nan=False))


def silence(stderr: bool = False) -> None:
    """Redirects stdout or stderr to nowhere: after a pipe is closed, every further line and flush would fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), (sys.stderr if stderr else sys.stdout).fileno())


def to_stderr() -> None:
    """Redirects stdout to stderr, without what is still in its buffer."""
    silence()
    sys.stdout.flush()
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())


@contextmanager
def progress_bar() -> Iterator[Progress | None]:
    """A progress bar on stderr if that is a terminal; otherwise None."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar, compiling_announced() as announce:
        task = bar.add_task("reading", total=1.0)

        def update(fraction: float, text: str) -> None:
            if text.startswith(COMPILING):
                announce()
            bar.update(task, completed=fraction, description=text)

        yield update


def compiled_beforehand() -> None:
    """Compiles what a tracker needs before it begins: meanwhile a vehicle would fly on. A line says so."""
    from rotorfit.app.first_use import TRACKING, compile_beforehand

    @cache
    def say(text: str) -> None:
        click.echo(text, err=True)

    with progress_bar() as progress:  # where there is no bar a line must do
        compile_beforehand(TRACKING, progress or (lambda _fraction, text: say(text.partition(":")[0])))
