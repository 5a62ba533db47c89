"""Verbs before any fit: logs, cards, formats; the demo; and the local web page."""

from collections.abc import Sequence
from pathlib import Path

import click

from rotorfit.app.cli.options import JSON, LOGS, PORT, card_option, file_at, print_json, progress_bar


@click.command()
@click.argument("directory", metavar="[DIR]", type=file_at(file_okay=False), default=Path("rotorfit-demo"))
@JSON
def demo(directory: Path, as_json: bool) -> None:
    """Simulate, fit, validate, report: no drone needed.

    Six simulated flights, both methods, the proof and the report go to DIR (./rotorfit-demo).
    """
    from rotorfit.app.demo import demo as run
    from rotorfit.app.demo import demo_mapping

    with progress_bar() as progress:
        result = run(directory, progress)
    if as_json:
        return print_json(demo_mapping(result))
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.outlook import demo_view

    return show(demo_view(result))


@click.command()
@LOGS
@card_option("the one that fits")
@click.option(
    "--draft-card",
    "draft",
    type=file_at(dir_okay=False),
    metavar="FILE",
    help="Write a draft card for the log, to be edited.",
)
@click.option("--fresh", is_flag=True, help="Draft from names and motion even if a built-in card fits.")
@JSON
def info(logs: Sequence[str], card: str | None, draft: Path | None, fresh: bool, as_json: bool) -> None:
    """Show what is inside logs.

    Tables, columns, rates, gaps; which card fits; stale frames, clocks, the excitation of each axis; findings.
    """
    from dataclasses import asdict

    from rotorfit.diagnosis.card_draft import NO_COMMAND, write_draft
    from rotorfit.diagnosis.survey import survey_draft, survey_logs
    from rotorfit.files.log_span import parse_log
    from rotorfit.files.logs import read

    if draft and len(logs) > 1:
        raise click.UsageError("--draft-card drafts for one log: give one")
    if fresh and not draft:
        raise click.UsageError("--fresh is about --draft-card: give its file")
    missing: tuple[str, ...] = ()
    with progress_bar() as progress:
        if draft:
            missing = write_draft(read(parse_log(logs[0]).path, progress=progress), draft, fresh)
        surveys = survey_logs(logs, card, progress) if card or not draft else (survey_draft(logs[0], draft),)
    if as_json:
        return print_json({"logs": [asdict(survey) for survey in surveys], "draft_card": draft and str(draft)})
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.contents import survey_view

    for number, survey in enumerate(surveys):
        show([*([""] if number else []), *survey_view(survey)])
    if draft and NO_COMMAND in missing:
        click.echo(
            f"\nCard written to {draft} without a command: none was found in {logs[0]}, and without one nothing can be "
            "fitted. Name its columns in the lines of [command] marked EDIT, or record the commands too."
        )
    elif draft:
        first = f"fill in {', '.join(missing)} in the lines marked EDIT, " if missing else ""
        click.echo(f"\nCard written to {draft}: {first}check every line, then rotorfit fit {logs[0]} --card {draft}")
    return None


@click.command()
@click.argument("name", required=False)
@JSON
def cards(name: str | None, as_json: bool) -> None:
    """List the built-in cards, or print one."""
    from rotorfit.files.cards import builtin_card_text, builtin_cards

    if name and not as_json:
        return click.echo(builtin_card_text(name), nl=False)
    known = builtin_cards()
    if name:
        builtin_card_text(name)
        return print_json(dict(known[name].raw))
    if as_json:
        return print_json({"cards": {name: card.raw for name, card in known.items()}})
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.contents import cards_view

    return show(cards_view(known))


@click.command()
@JSON
def formats(as_json: bool) -> None:
    """List the log formats that can be read."""
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.contents import formats_view
    from rotorfit.files.logs.formats import FORMATS

    if as_json:
        return print_json({"formats": {name: form.text for name, form in FORMATS.items()}})
    return show(formats_view(FORMATS))


@click.command()
@click.argument("folder", metavar="[FOLDER]", type=file_at(file_okay=False), required=False)
@click.option("--port", type=PORT, default=0, metavar="N", help="Port to listen on; default: any free one.")
@JSON
def studio(folder: Path | None, port: int, as_json: bool) -> None:
    """Open a local web page: drop logs, check the card, fit, compare, download.

    The session is stored in FOLDER (default: your own state folder) and resumed from there. Only this machine can
    reach the page.
    """
    from rotorfit.app.web import studio as serve

    def ready(address: str, kept: Path) -> None:
        if as_json:
            return print_json({"address": address, "workspace": str(kept)})
        return click.echo(f"Open {address}\nThe session is kept in {kept}. Ctrl-C ends the studio.")

    serve(folder, port, ready)
