"""Verbs that score models on flights that they were not fitted to."""

from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any

import click

from rotorfit.app.cli.options import (
    JSON,
    LOGS,
    MODEL,
    SPAN,
    card_option,
    file_at,
    horizons_of,
    print_json,
    progress_bar,
    say_kept,
)
from rotorfit.core.errors import ModelError


@click.command()
@MODEL
@LOGS
@card_option("the model's own")
@SPAN
@click.option("--horizons", metavar="0.5,1,2,5", callback=horizons_of, help="How far to predict [s].")
@JSON
def validate(model_path: str, logs: Sequence[str], card: str | None, span: Any, horizons: Any, as_json: bool) -> None:
    """Score a model on flights that were not fitted."""
    from rotorfit.app.workflows import validate_logs
    from rotorfit.assessment.validation import to_mapping
    from rotorfit.files.log_span import parse_log
    from rotorfit.files.mistaken import kind_of
    from rotorfit.files.models import load

    if kind_of(Path(model_path)) == "log":
        models = [log for log in logs if kind_of(Path(log)) == "model"]
        if models:
            raise ModelError(f"the model comes first: `rotorfit validate {quote(models[0])} {quote(model_path)}`")
    model = load(model_path)
    with progress_bar() as progress:
        validation, _ = validate_logs(model, [parse_log(log, span) for log in logs], card, horizons, progress)
    if as_json:
        return print_json(to_mapping(validation))
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.scores import validation_view

    show(validation_view(validation))
    return None


@click.command()
@click.argument("paths", metavar="MODEL... LOG...", nargs=-1, required=True)
@JSON
def compare(paths: Sequence[str], as_json: bool) -> None:
    """Score several models side by side on the same flights."""
    from rotorfit.app.comparison import compare_logs, comparison_mapping

    with progress_bar() as progress:
        comparison = compare_logs(paths, progress=progress)
    if as_json:
        return print_json(comparison_mapping(comparison))
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.scores import comparison_view

    return show(comparison_view(comparison))


@click.command()
@click.argument("paths", metavar="MODEL... LOG...", nargs=-1, required=True)
@click.option("-o", "output", type=file_at(), metavar="report.html", required=True, help="The page to write.")
@card_option("the model's own")
@click.option("--figures", type=file_at(file_okay=False), metavar="DIR", help="Also write figures for a paper here.")
@JSON
def report(paths: Sequence[str], output: Path, card: str | None, figures: Path | None, as_json: bool) -> None:
    """Write one self-contained page about a model and its proof, or about several side by side."""
    from rotorfit.app.workflows import cases_of, check_page
    from rotorfit.assessment.evidence import evidence_of
    from rotorfit.reporting import write_figures, write_report

    check_page(output)
    with progress_bar() as progress:
        cases, left_out = cases_of(paths, card, progress)
    if figures and len(cases) > 1:
        raise click.UsageError("--figures draws one model: give one, or leave it out")
    evidences = evidence_of(cases)
    say_kept(write_report(evidences, output))
    drawn = write_figures(evidences[0], figures) if figures else []
    if as_json:
        return print_json({"report": str(output), "figures": [str(path) for path in drawn], "notes": left_out})
    for line in (*left_out, f"Report written to {output}.", *(f"Figure written to {path}." for path in drawn)):
        click.echo(line)
    return None
