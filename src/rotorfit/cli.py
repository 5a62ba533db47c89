"""The command line: each verb parses, calls the library, and prints.

What is heavy (numpy, numba, rich) is imported by the verb that needs it, so that `rotorfit --help` answers at once.
"""

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click

from rotorfit import __version__
from rotorfit.errors import RotorfitError

Progress = Callable[[float, str], None]
Function = TypeVar("Function", bound=Callable[..., Any])


class _Verbs(click.Group):
    """Verbs in the order of the work. A known error ends with one line and 1; a bug keeps its trace."""

    def list_commands(self, _ctx: click.Context) -> list[str]:
        return list(self.commands)

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the verb; what the user can act on becomes one line."""
        try:
            return super().invoke(ctx)
        except RotorfitError as error:
            raise click.ClickException(" ".join(str(error).split())) from error
        except BrokenPipeError:  # the reader of our output has seen enough: click ends quietly
            raise
        except OSError as error:
            if not error.strerror:
                raise
            where = f"{error.filename}: " if error.filename else ""
            line = f"{where}{error.strerror}; check the path, its permissions and the room on the disk"
            raise click.ClickException(line) from error


@click.group(cls=_Verbs, subcommand_metavar="VERB ...")
@click.version_option(__version__, prog_name="rotorfit", message="%(prog)s %(version)s")
def main() -> None:
    """From a flight log to a trustworthy model of a velocity-commanded multirotor.

    LOG is a file of any known format (`rotorfit formats`), or LOG@T0:T1 for a part of it in seconds.
    A+B are two files of one flight, commands and poses.
    """


def _span(ctx: click.Context, _parameter: click.Parameter, text: str | None) -> Any:
    from rotorfit.pipeline import WHOLE, parse_span

    try:
        return WHOLE if text is None else parse_span(text)
    except RotorfitError as error:
        raise click.BadParameter(str(error), ctx) from None


def _axes(ctx: click.Context, _parameter: click.Parameter, text: str | None) -> Any:
    from rotorfit.frames import AXES

    axes = AXES if text is None else tuple(part.strip() for part in text.split(","))
    unknown = [axis for axis in axes if axis not in AXES]
    if unknown:
        raise click.BadParameter(f"no such axis: {', '.join(map(repr, unknown))}; axes are {', '.join(AXES)}", ctx)
    return axes


def _some_axes(ctx: click.Context, parameter: click.Parameter, text: str | None) -> Any:
    return None if text is None else _axes(ctx, parameter, text)


def _structure(ctx: click.Context, _parameter: click.Parameter, name: str | None) -> Any:
    from rotorfit.structure import FIRST_ORDER_DELAY, STRUCTURES

    if name is not None and name != "auto" and name not in STRUCTURES:
        raise click.BadParameter(f"no such structure: {name!r}; structures are auto, {', '.join(STRUCTURES)}", ctx)
    return name or FIRST_ORDER_DELAY.name


def _horizons(ctx: click.Context, _parameter: click.Parameter, text: str | None) -> Any:
    from rotorfit.forecast import HORIZONS

    try:
        horizons = HORIZONS if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        horizons = ()
    if not horizons or not all(0 < horizon < float("inf") for horizon in horizons):
        raise click.BadParameter(f"{text!r} is no list of positive seconds, such as 0.5,1,2,5", ctx)
    return horizons


def _file(**more: Any) -> click.Path:
    return click.Path(path_type=Path, **more)


_logs = click.argument("logs", metavar="LOG...", nargs=-1, required=True)
_model = click.argument("model_path", metavar="MODEL")


def _card(default: str) -> Callable[[Function], Function]:
    return click.option("--card", metavar="C", help=f"Name of a built-in card, or a TOML file; default: {default}.")


_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
_span_option = click.option(
    "--span", metavar="T0:T1", callback=_span, help="Part of every log [s], from the start of its common window."
)


@main.command()
@click.argument("directory", metavar="[DIR]", type=_file(file_okay=False), default=Path("rotorfit-demo"))
@_json
def demo(directory: Path, as_json: bool) -> None:
    """Simulate, fit, validate, report: no drone needed.

    Six simulated flights, both methods, the proof and the report go to DIR (./rotorfit-demo).
    """
    from rotorfit.demo import demo as run
    from rotorfit.demo import demo_mapping

    with _progress() as progress:
        result = run(directory, progress)
    if as_json:
        return _print_json(demo_mapping(result))
    from rotorfit.terminal import show
    from rotorfit.terminal.demo import demo_view

    return show(demo_view(result))


@main.command()
@_logs
@_card("the one that fits")
@click.option(
    "--draft-card", "draft", type=_file(dir_okay=False), metavar="FILE", help="Write a card for the log, to be edited."
)
@_json
def info(logs: Sequence[str], card: str | None, draft: Path | None, as_json: bool) -> None:
    """Show what is inside logs.

    Tables, columns, rates, gaps; which card fits; stale frames, clocks, the excitation of each axis; findings.
    """
    from dataclasses import asdict

    from rotorfit.draft import write_draft
    from rotorfit.sources import read
    from rotorfit.survey import survey_draft, survey_logs

    if draft and len(logs) > 1:
        raise click.UsageError("--draft-card drafts for one log: give one")
    if draft:
        write_draft(read(logs[0]), draft)
    surveys = survey_logs(logs, card) if card or not draft else (survey_draft(logs[0], draft),)
    if as_json:
        return _print_json({"logs": [asdict(survey) for survey in surveys], "draft_card": draft and str(draft)})
    from rotorfit.terminal import show
    from rotorfit.terminal.survey import survey_view

    for number, survey in enumerate(surveys):
        show([*([""] if number else []), *survey_view(survey)])
    if draft:
        click.echo(f"\nCard written to {draft}: check every line, then rotorfit fit {logs[0]} --card {draft}")
    return None


@main.command()
@_logs
@_card("the one that fits")
@click.option(
    "--method",
    type=click.Choice(["ml", "robust", "paper", "svf", "weak", "iv", "oe"]),
    default="ml",
    help="The likelihood (default), without outliers, the paper's, or a rung between them.",
)
@click.option(
    "--structure", metavar="S", callback=_structure, help="The law of every axis, or auto; default: first_order_delay."
)
@click.option("--axes", metavar="x,y,z,yaw", callback=_axes, help="The axes to fit; default: all.")
@_span_option
@click.option("--leave-one-out", "leaving", is_flag=True, help="Also score each flight by a model of the others.")
@click.option("--uncertainty", is_flag=True, help="Add the accuracy table: five standard errors, correlations.")
@click.option("--prior", is_flag=True, help="Use the priors of the card; what they did is reported.")
@click.option("-o", "output", type=_file(), metavar="model.json", help="Write the model file.")
@_json
def fit(
    logs: Sequence[str],
    card: str | None,
    method: Any,
    structure: Any,
    axes: Any,
    span: Any,
    leaving: bool,
    uncertainty: bool,
    prior: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """Estimate the coefficients from one or several flights."""
    from rotorfit.fit import LIKELIHOOD
    from rotorfit.leave_one_out import require_two
    from rotorfit.model_file import save, to_mapping
    from rotorfit.pipeline import MODEL_MARK, check_destination, fit_logs, leave_one_out_logs, parse_log

    if output:
        check_destination(output, MODEL_MARK)
    if leaving:
        require_two(len(logs))
    if uncertainty and method not in LIKELIHOOD:
        raise click.UsageError(f"--uncertainty is of the likelihood: --method {method} has its own standard errors")
    with _progress() as progress:
        spans = [parse_log(log, span) for log in logs]
        result, left_out = fit_logs(spans, card, method, axes, progress, structure, uncertainty, prior), None
        if leaving:
            result, left_out = leave_one_out_logs(result, axes, progress, structure)
    model = result.model
    if output:
        save(model, output)
    if as_json:
        return _print_json(to_mapping(model))
    from rotorfit.terminal import show
    from rotorfit.terminal.model import model_view
    from rotorfit.terminal.scores import left_out_view

    show(model_view(model, axes))
    if left_out:
        show(left_out_view(left_out, model))
    click.echo(f"\nModel written to {output}." if output else "\nNothing was written; -o model.json keeps the model.")
    return None


@main.command()
@_logs
@_card("the one that fits")
@click.option("--axes", metavar="x,y,z,yaw", callback=_axes, help="The axes to fit; default: all.")
@_span_option
@_json
def ladder(logs: Sequence[str], card: str | None, axes: Any, span: Any, as_json: bool) -> None:
    """Fit by every method, side by side, and test their agreement."""
    from rotorfit.ladder import to_mapping
    from rotorfit.pipeline import ladder_logs, parse_log

    with _progress() as progress:
        result = ladder_logs([parse_log(log, span) for log in logs], card, axes, progress)
    if as_json:
        return _print_json(to_mapping(result))
    from rotorfit.terminal import show
    from rotorfit.terminal.ladder import ladder_view

    return show(ladder_view(result))


@main.command()
@_model
@_logs
@_card("the model's own")
@_span_option
@click.option("--horizons", metavar="0.5,1,2,5", callback=_horizons, help="How far to predict [s].")
@_json
def validate(model_path: str, logs: Sequence[str], card: str | None, span: Any, horizons: Any, as_json: bool) -> None:
    """Score a model on flights that were not fitted."""
    from rotorfit.model_file import load
    from rotorfit.pipeline import parse_log, validate_logs
    from rotorfit.validation import to_mapping

    model = load(model_path)
    with _progress() as progress:
        validation, _ = validate_logs(model, [parse_log(log, span) for log in logs], card, horizons, progress)
    if as_json:
        return _print_json(to_mapping(validation))
    from rotorfit.terminal import show
    from rotorfit.terminal.scores import validation_view

    if model.conversion:
        click.echo(
            "The model was converted: it is for flights under its new limits, not those that it was fitted to.\n"
        )
    return show(validation_view(validation))


@main.command()
@click.argument("paths", metavar="MODEL... LOG...", nargs=-1, required=True)
@_json
def compare(paths: Sequence[str], as_json: bool) -> None:
    """Score several models side by side on the same flights."""
    from rotorfit.pipeline import compare_logs, comparison_mapping

    with _progress() as progress:
        comparison = compare_logs(paths, progress=progress)
    if as_json:
        return _print_json(comparison_mapping(comparison))
    from rotorfit.terminal import show
    from rotorfit.terminal.scores import comparison_view

    return show(comparison_view(comparison))


@main.command()
@_model
@_logs
@click.option("-o", "output", type=_file(), metavar="report.html", required=True, help="The page to write.")
@click.option("--figures", type=_file(file_okay=False), metavar="DIR", help="Also write figures for a paper here.")
@_json
def report(model_path: str, logs: Sequence[str], output: Path, figures: Path | None, as_json: bool) -> None:
    """Write one self-contained page about a model and its proof."""
    from rotorfit.forecast import CURVE
    from rotorfit.model_file import load
    from rotorfit.pipeline import REPORT_MARK, check_destination, parse_log, training_flights, validate_logs
    from rotorfit.report import write_figures, write_report

    check_destination(output, REPORT_MARK)
    model = load(model_path)
    with _progress() as progress:
        validation, flights = validate_logs(model, [parse_log(log) for log in logs], horizons=CURVE, progress=progress)
    training, left_out = training_flights(model)
    write_report(model, training, validation, flights, output)
    drawn = write_figures(model, training, validation, flights, figures) if figures else []
    if as_json:
        return _print_json({"report": str(output), "figures": [str(path) for path in drawn], "notes": left_out})
    for line in (*left_out, f"Report written to {output}.", *(f"Figure written to {path}." for path in drawn)):
        click.echo(line)
    return None


@main.command()
@_model
@click.option(
    "--limits",
    metavar="tilt=20deg,...",
    required=True,
    help="New tilt, vertical_speed, yaw_rate or speed; without a unit in SI.",
)
@click.option("-o", "output", type=_file(), metavar="other.json", required=True, help="The model file to write.")
@_json
def convert(model_path: str, limits: str, output: Path, as_json: bool) -> None:
    """Convert a model to other limits: the same drone under another tilt, climb or rotation limit."""
    from rotorfit.convert import convert as to_limits
    from rotorfit.frames import AXES
    from rotorfit.model_file import load, save, to_mapping
    from rotorfit.pipeline import MODEL_MARK, check_destination
    from rotorfit.settings import limits_from_text

    check_destination(output, MODEL_MARK)
    if output.exists() and output.samefile(model_path):
        raise click.UsageError(f"-o {output} is the model that is converted: give the converted one another name")
    model = to_limits(load(model_path), limits_from_text(limits))
    save(model, output)
    if as_json:
        return _print_json(to_mapping(model))
    from rotorfit.terminal import show
    from rotorfit.terminal.model import model_view

    show(model_view(model, AXES))
    click.echo(f"\nModel written to {output}.")
    return None


@main.command()
@_model
@click.option(
    "--design",
    type=click.Choice(["predictor", "lqr", "linearising"]),
    default="predictor",
    help="The law: state predictor (default), LQR with the delay, or feedback linearisation.",
)
@click.option("--rate", type=float, default=50.0, metavar="HZ", help="Commands a second; default: 50.")
@click.option(
    "--latency", type=float, default=0.015, metavar="S", help="Age of a pose when it is used; default: 0.015 s."
)
@click.option("--axes", metavar="x,y,z,yaw", callback=_axes, help="The axes to tune; default: all.")
@click.option("--peak", type=float, default=1.7, metavar="MS", help="Highest peak of the sensitivity; default: 1.7.")
@click.option("--seed", type=int, default=0, metavar="N", help="Of the vehicles drawn from the covariance; default: 0.")
@click.option("--try", "address", metavar="VEHICLE", help="Fly them in the flight room: bebop2,wind=1.5,gusts=0.3.")
@click.option("-o", "output", type=_file(dir_okay=False), metavar="gains.toml", help="Write the gains (.toml, .yaml).")
@_json
def tune(
    model_path: str,
    design: Any,
    rate: float,
    latency: float,
    axes: Any,
    peak: float,
    seed: int,
    address: str | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Gains of a position controller, as fast as what is known allows."""
    from rotorfit.gains_file import GAINS_MARK, save_gains, tuning_mapping
    from rotorfit.model_file import load
    from rotorfit.pipeline import check_destination
    from rotorfit.tune import tune as tuned

    if output:
        check_destination(output, GAINS_MARK)
    model = load(model_path)
    tuning = tuned(model, design, rate=rate, latency=latency, axes=axes, peak=peak, seed=seed)
    if output:
        save_gains(tuning, model, output)
    scores = None
    if address:
        from rotorfit.trial import scores_mapping, try_tuning

        scores = try_tuning(tuning, model, address)
    if as_json:
        return _print_json(tuning_mapping(tuning, model) | ({"trial": scores_mapping(scores)} if scores else {}))
    from rotorfit.terminal import show
    from rotorfit.terminal.tuning import trial_view, tuning_view

    show(tuning_view(tuning))
    if scores and address:
        click.echo()
        show(trial_view(scores, address))
    click.echo(f"\nGains written to {output}." if output else "\nNothing was written; -o gains.toml keeps the gains.")
    return None


@main.command()
@click.option("--card", metavar="C", help="Built-in card, TOML file, or sim:VEHICLE; with the limits.")
@click.option("--after", type=_file(dir_okay=False), metavar="model.json", help="Propose the flight to add to a model.")
@click.option(
    "--design",
    type=click.Choice(["two_sines", "multisine", "chirp", "doublets", "3211", "prbs", "ident", "optimal", "optimal_a"]),
    help="How the signals come about; default: multisine, or with --after the one that tells most.",
)
@click.option("--room", metavar="6x4x3", help="Size of the room [m], origin amid its floor; default: 6x4x3.")
@click.option("--box", metavar="x0,y0,z0,x1,y1,z1", help="The fence itself, in the frame of the poses [m].")
@click.option(
    "--axes", metavar="x,y,z,yaw", callback=_some_axes, help="To excite; default: all, or --after the worst known."
)
@click.option("--separate", is_flag=True, help="Separate flights, as the paper: x with y, z, yaw.")
@click.option("--open-loop", is_flag=True, help="No feedback on any axis.")
@click.option("--duration", type=float, default=60.0, metavar="S", help="Of each flight, at most; default: 60.")
@click.option("--amplitude", type=float, metavar="A", help="Factor on the full amplitude; default: what fits.")
@click.option("--speed", type=float, metavar="V", help="Largest speed along x and y [m/s]; default: 1.5.")
@click.option("--seed", type=click.IntRange(min=0), default=0, metavar="N", help="Of sequences and draws; default: 0.")
@click.option("-o", "output", type=_file(), metavar="plan.toml", help="Write the plan file.")
@click.option("--picture", type=_file(), metavar="plan.png", help="Draw commands, path, speeds, standard errors.")
@_json
def plan(output: Path | None, picture: Path | None, as_json: bool, **asked: Any) -> None:
    """Design a flight and predict what it will tell, and where it leads."""
    from rotorfit.pipeline import check_destination
    from rotorfit.plan_file import PLAN_MARK, save_plan
    from rotorfit.preview import PICTURE_MARK, write_picture
    from rotorfit.request import Request, destinations, planned, plans_mapping

    request = Request(**asked)
    files, pictures = (destinations(path, request) if path else [] for path in (output, picture))
    for path, mark in [*((path, PLAN_MARK) for path in files), *((path, PICTURE_MARK) for path in pictures)]:
        check_destination(path, mark)
    with _progress() as progress:
        plans, proposal = planned(request, progress)
    for one, path in zip(plans, files, strict=False):
        save_plan(one, path)
    for one, path in zip(plans, pictures, strict=False):
        write_picture(one, path)
    if as_json:
        return _print_json(plans_mapping(plans, files, pictures, proposal))
    from rotorfit.terminal import show
    from rotorfit.terminal.plan import next_view, plan_view

    if proposal:
        show(next_view(proposal))
    for number, one in enumerate(plans):
        show([*([""] if number else []), *plan_view(one)])
    for path in (*files, *pictures):
        click.echo(f"\nWritten to {path}.")
    if not files:
        click.echo("\nNothing was written; -o plan.toml keeps the plan.")
    return None


@main.command()
@click.argument("plan_path", metavar="PLAN")
@click.option(
    "--link", "link", metavar="NAME[:ADDRESS]", required=True, help="sim, replay, ros1, ros2, mavlink, tello."
)
@click.option("--poses", metavar="NAME:ADDRESS", default="", help="Take the poses from another link: ros1:/TOPIC.")
@click.option("-o", "output", type=_file(), metavar="flight.mcap", required=True, help="The recording to write.")
@_card("the plan's own")
@click.option("--land/--no-land", default=True, help="Land at the end, whatever ended the flight (default), or hover.")
@click.option("--take-off", is_flag=True, help="Begin on the floor.")
@click.option("--seed", type=int, default=0, help="Of a simulated vehicle.")
@click.option("--yes", is_flag=True, help="Do not ask before a real vehicle moves.")
@_json
def fly(
    plan_path: str, link: str, poses: str, output: Path, card: str | None, land: bool, take_off: bool, seed: int,
    yes: bool, as_json: bool,
) -> None:  # fmt: skip
    """Fly a plan under guard and record it; Ctrl-C or the space bar ends it in hover."""
    from rotorfit.errors import LinkError
    from rotorfit.mission import flown_mapping, flown_mission, mission
    from rotorfit.preflight import refuse
    from rotorfit.terminal import show
    from rotorfit.terminal.flight import flown_view, next_command, preflight_view, status_line

    with mission(plan_path, link, output, card, take_off, seed, poses) as wanted:
        if not as_json:
            show(preflight_view(wanted.plan, link, wanted.ready, wanted.link.fail_safe))
        refuse(wanted.ready)
        if wanted.link.live and not yes:
            click.confirm("A real vehicle will move. Fly?", abort=True, err=True)
        result = flown_mission(wanted, land, status_line)
    if result.reason != "completed":
        raise LinkError(
            f"ended early, after {result.duration:.1f} s of the plan: {result.text}; the log so far: {result.path}"
        )
    if as_json:
        return _print_json(flown_mapping(result, wanted.ready))
    show(flown_view(result))
    return click.echo(f"\nNext: {next_command([str(output)])}")


@main.command()
@click.argument("name", required=False)
@_json
def cards(name: str | None, as_json: bool) -> None:
    """List the built-in cards, or print the one that is named."""
    from rotorfit.card import builtin_card_text, builtin_cards

    if name and not as_json:
        return click.echo(builtin_card_text(name), nl=False)
    known = builtin_cards()
    if name:
        builtin_card_text(name)
        return _print_json(dict(known[name].raw))
    if as_json:
        return _print_json({"cards": {name: card.raw for name, card in known.items()}})
    from rotorfit.terminal import show
    from rotorfit.terminal.lists import cards_view

    return show(cards_view(known))


@main.command()
@_json
def formats(as_json: bool) -> None:
    """List the formats of logs that can be read."""
    from rotorfit.sources import FORMATS
    from rotorfit.terminal import show
    from rotorfit.terminal.lists import FORMATS as WORDS
    from rotorfit.terminal.lists import formats_view

    if as_json:
        return _print_json({"formats": {name: WORDS[name] for name in FORMATS}})
    return show(formats_view(FORMATS))


def _print_json(result: Any) -> None:
    click.echo(json.dumps(result, indent=1, allow_nan=False))


@contextmanager
def _progress() -> Iterator[Progress | None]:
    """A bar on stderr where that is a terminal; nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda fraction, text: bar.update(task, completed=fraction, description=text)
