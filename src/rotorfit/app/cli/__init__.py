"""The command line: each verb parses, calls the library, and prints; a module holds verbs of one kind.

What is heavy (numpy, numba, rich) is imported by the verb that needs it, so that `rotorfit --help` answers at once.
"""

import io
import os
import sys
from typing import Any

import click

from rotorfit.app.cli.flying import fly, plan
from rotorfit.app.cli.handover import export, tune
from rotorfit.app.cli.interruption import safe_interrupts
from rotorfit.app.cli.logs import cards, demo, formats, info, studio
from rotorfit.app.cli.models import convert, fit, ladder
from rotorfit.app.cli.scoring import compare, report, validate
from rotorfit.app.cli.tracking import track
from rotorfit.core.errors import RotorfitError
from rotorfit.core.plain import line_of
from rotorfit.version import __version__

VERBS = (
    demo, info, fit, ladder, validate, compare, report, convert, tune, export, plan, fly, track, cards, formats, studio,
)  # fmt: skip
"""In the order of the work."""


BLAS_THREADS = "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"
"""What tells numpy's linear algebra how many threads it may use."""

LONGEST_LINE = 2000
"""Most characters of an error: values of a file are quoted in it."""


class _Verbs(click.Group):
    """Verbs in the order of the work. A known error ends with one line and 1; a bug keeps its trace."""

    def list_commands(self, _ctx: click.Context) -> list[str]:
        return list(self.commands)

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the verb; what the user can act on becomes one line."""
        if isinstance(sys.stdout, io.TextIOWrapper):  # a file's name may be no text
            sys.stdout.reconfigure(errors="backslashreplace")
        for name in BLAS_THREADS:  # its matrices here are so small that threads only wait; no verb has imported it yet
            os.environ.setdefault(name, "1")
        try:
            with safe_interrupts():
                return super().invoke(ctx)
        except RotorfitError as error:
            raise click.ClickException(line_of(error, LONGEST_LINE)) from error
        except BrokenPipeError:  # the reader of our output has seen enough: click ends quietly
            raise
        except OSError as error:
            if not error.strerror:
                raise
            where = f"{error.filename}: " if error.filename else ""
            line = f"{where}{error.strerror}; check the path, its permissions and the room on the disk"
            raise click.ClickException(line_of(line, LONGEST_LINE)) from error


@click.group(cls=_Verbs, commands=VERBS, subcommand_metavar="VERB ...")
@click.version_option(__version__, prog_name="rotorfit", message="%(prog)s %(version)s")
def main() -> None:
    """From a flight log to a trustworthy model of a velocity-commanded multirotor.

    LOG is a file of any known format (`rotorfit formats`), or LOG@T0:T1 for a part of it in seconds.
    A+B are two files of one flight, commands and poses.
    """
