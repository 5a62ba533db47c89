"""The verb that follows a vehicle while it flies, or a log as if it did."""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorfit.app.cli.options import card_option, file_at, say_kept, structure_of

if TYPE_CHECKING:
    from rotorfit.core.tracked import Track, Tracked


@click.command()
@click.argument("log", metavar="LOG")
@card_option("the one that fits")
@click.option("--jsonl", is_flag=True, help="Print one JSON object a line: states, alarms, and the end.")
@click.option(
    "--false-alarms-per-hour",
    "false_alarms",
    type=click.FloatRange(1e-6, 60),
    default=0.1,
    show_default=True,
    help="How many false alarms are to be expected at the most.",
)
@click.option(
    "--structure",
    metavar="S",
    callback=structure_of,
    help="The law of every axis; default: averaged, over laws that the data cannot tell apart.",
)
@click.option(
    "--pace",
    type=click.FloatRange(min=0.01),
    metavar="P",
    help="Seconds of flight a second: 1 is as it was flown. Default: as fast as it goes.",
)
@click.option("-o", "output", type=file_at(), metavar="model.json", help="Write the model; of several regimes each.")
@click.option("--report", "page", type=file_at(), metavar="track.html", help="Write a page about the flight.")
def track(
    log: str,
    card: str | None,
    jsonl: bool,
    false_alarms: float,
    structure: Any,
    pace: float | None,
    output: Path | None,
    page: Path | None,
) -> None:
    """Follow the model while the vehicle flies, and tell when it changes."""
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.tracking import news, track_view
    from rotorfit.app.workflows import MODEL_MARK, REPORT_MARK, check_destination, load_flight
    from rotorfit.files.log_span import parse_log
    from rotorfit.tracking.replayed import tracked

    if output:
        check_destination(output, MODEL_MARK)
    if page:
        check_destination(page, REPORT_MARK)
    flight = load_flight(parse_log(log), card)
    begun = time.monotonic()
    before: Tracked | None = None

    def told(state: "Tracked") -> None:
        nonlocal before
        if pace:
            time.sleep(max(state.time / pace - (time.monotonic() - begun), 0.0))
        if jsonl:
            for line in (*(alarm.to_mapping() for alarm in state.alarms), state.to_mapping()):
                click.echo(json.dumps(line, allow_nan=False))
        else:
            show(news(before, state))
        before = state

    result = tracked(flight, structure, false_alarms, told)
    files = _written(result, output) if output else [None] * len(result.regimes)
    if page:
        from rotorfit.reporting import write_timeline

        say_kept(write_timeline(result, flight, page, files))
    if jsonl:
        click.echo(json.dumps(_end(result, files, page), allow_nan=False))
    else:
        show(track_view(result))
        if page:
            click.echo(f"Report written to {page}.")


def _end(result: "Track", files: Sequence[Path | None], page: Path | None) -> dict[str, Any]:
    """The last line of JSON."""
    return {
        "type": "end",
        "time": result.states[-1].time,
        "alarms": len(result.alarms),
        "regimes": [{"start": one.start, "end": one.end} for one in result.regimes],
        "models": [str(path) for path in files if path],
        "report": str(page) if page else None,
    }


def _written(result: "Track", output: Path) -> list[Path | None]:
    """Writes the model of each regime that has one, with a number where there are several; None where there is none."""
    from rotorfit.files.models import save

    several = len(result.regimes) > 1
    files: list[Path | None] = []
    for number, regime in enumerate(result.regimes, 1):
        path = output.with_stem(f"{output.stem}-{number}") if several else output
        if regime.model:
            say_kept(save(regime.model, path))
        files.append(path if regime.model else None)
    return files
