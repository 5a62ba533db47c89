"""Verbs that make a model, from flights or from another model."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from rotorfit.app.cli.options import (
    JSON,
    LOGS,
    MODEL,
    SPAN,
    axes_of,
    card_option,
    file_at,
    print_json,
    progress_bar,
    say_kept,
    structure_of,
)
from rotorfit.estimation.methods import BEST, METHODS


@click.command()
@LOGS
@card_option("the one that fits")
@click.option(
    "--method",
    type=click.Choice(list(METHODS)),
    default=BEST,
    help="Estimation method; default: ml, maximum likelihood. `rotorfit ladder` compares all.",
)
@click.option(
    "--structure",
    metavar="S",
    callback=structure_of,
    help="Law of every axis, or auto; default: averaged, over the laws that the data do not distinguish.",
)
@click.option("--axes", metavar="x,y,z,yaw", callback=axes_of, help="The axes to fit; default: all.")
@SPAN
@click.option(
    "--leave-one-out", "leaving", is_flag=True, help="Also score each flight with a model fitted to the others."
)
@click.option(
    "--uncertainty", is_flag=True, help="Add the accuracy table: five kinds of standard error, and correlations."
)
@click.option("--prior", is_flag=True, help="Use the priors of the card, and report their effect.")
@click.option("-o", "output", type=file_at(), metavar="model.json", help="Write the model file.")
@JSON
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
    from rotorfit.app.workflows import MODEL_MARK, check_destination, fit_logs, leave_one_out_logs
    from rotorfit.assessment.leave_one_out import require_two
    from rotorfit.files.log_span import parse_log
    from rotorfit.files.models import lost_axes, save, to_mapping

    if output:
        check_destination(output, MODEL_MARK)
    if leaving:
        require_two(len(logs))
    if uncertainty and not METHODS[method].likelihood:
        raise click.UsageError(f"--uncertainty is of the likelihood: --method {method} has its own standard errors")
    with progress_bar() as progress:
        spans = [parse_log(log, span) for log in logs]
        result, left_out = fit_logs(spans, card, method, axes, progress, structure, uncertainty, prior), None
        if leaving:
            result, left_out = leave_one_out_logs(result, axes, progress, structure)
    model = result.model
    if output:
        kept = save(model, output)
        say_kept(kept, lost_axes(kept, model))
    if as_json:
        return print_json(to_mapping(model))
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.coefficients import model_view
    from rotorfit.app.terminal.scores import left_out_view

    show(model_view(model, axes))
    if left_out:
        show(left_out_view(left_out, model))
    click.echo(f"\nModel written to {output}." if output else "\nNothing was written; -o model.json keeps the model.")
    return None


@click.command()
@LOGS
@card_option("the one that fits")
@click.option("--axes", metavar="x,y,z,yaw", callback=axes_of, help="The axes to fit; default: all.")
@SPAN
@JSON
def ladder(logs: Sequence[str], card: str | None, axes: Any, span: Any, as_json: bool) -> None:
    """Fit by every method, side by side, and test their agreement."""
    from rotorfit.app.workflows import ladder_logs
    from rotorfit.assessment.method_comparison import to_mapping
    from rotorfit.files.log_span import parse_log

    with progress_bar() as progress:
        result = ladder_logs([parse_log(log, span) for log in logs], card, axes, progress)
    if as_json:
        return print_json(to_mapping(result))
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.scores import ladder_view

    return show(ladder_view(result))


@click.command()
@MODEL
@click.option(
    "--limits",
    metavar="tilt=20deg,...",
    required=True,
    help="New tilt, vertical_speed, yaw_rate or speed; in SI units unless a unit is given.",
)
@click.option("-o", "output", type=file_at(), metavar="other.json", required=True, help="The model file to write.")
@JSON
def convert(model_path: str, limits: str, output: Path, as_json: bool) -> None:
    """Convert a model to other limits: the same drone under another tilt, climb or rotation limit."""
    from rotorfit.app.workflows import MODEL_MARK, check_destination
    from rotorfit.core.frames import AXES
    from rotorfit.core.limits import limits_from_text
    from rotorfit.dynamics.other_limits import convert as to_limits
    from rotorfit.files.models import load, lost_axes, save, to_mapping

    check_destination(output, MODEL_MARK)
    if output.exists() and output.samefile(model_path):
        raise click.UsageError(f"-o {output} is the model that is converted: give the converted one another name")
    model = to_limits(load(model_path), limits_from_text(limits))
    kept = save(model, output)
    say_kept(kept, lost_axes(kept, model))
    if as_json:
        return print_json(to_mapping(model))
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.coefficients import model_view

    show(model_view(model, AXES))
    click.echo(f"\nModel written to {output}.")
    return None
