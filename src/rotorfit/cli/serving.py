"""The verb that serves the local web page."""

from pathlib import Path

import click

from rotorfit.cli.options import JSON, file_at
from rotorfit.cli.output import print_json


@click.command()
@click.argument("folder", metavar="[FOLDER]", type=file_at(file_okay=False), required=False)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="To listen on; default: a free one."
)
@JSON
def studio(folder: Path | None, port: int, as_json: bool) -> None:
    """Open a local web page: drop logs, check the card, fit, compare, download.

    The session is kept in FOLDER (default: your own state folder) and goes on there. Only this machine reaches it.
    """
    from rotorfit.studio import studio as serve

    def ready(address: str, kept: Path) -> None:
        if as_json:
            return print_json({"address": address, "workspace": str(kept)})
        return click.echo(f"Open {address}\nThe session is kept in {kept}. Ctrl-C ends the studio.")

    serve(folder, port, ready)
