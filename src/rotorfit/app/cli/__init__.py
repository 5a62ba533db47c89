"""The command line: each verb parses, calls the library, and prints; a module holds verbs of one kind.

Heavy packages (numpy, numba, rich) are imported by the verb that needs them, so that `rotorfit --help` is quick.
"""

import io
import os
import sys
from functools import partial
from typing import Any

import click

from rotorfit.app.cli.flying import fly, plan
from rotorfit.app.cli.handover import export, tune
from rotorfit.app.cli.interruption import safe_interrupts
from rotorfit.app.cli.logs import cards, demo, formats, info, studio
from rotorfit.app.cli.models import convert, fit, ladder
from rotorfit.app.cli.options import LONGEST_LINE
from rotorfit.app.cli.scoring import compare, report, validate
from rotorfit.app.cli.tracking import track
from rotorfit.core.call_stack import with_room
from rotorfit.core.errors import RotorfitError
from rotorfit.core.plain import line_of
from rotorfit.version import __version__

VERBS = (
    demo, info, fit, ladder, validate, compare, report, convert, tune, export, plan, fly, track, cards, formats, studio,
)  # fmt: skip
"""All verbs, in the order of the work."""


BLAS_THREADS = "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"
"""Environment variables that set the number of threads of numpy's linear algebra."""


class _Verbs(click.Group):
    """Verbs in the order of the work. A known error ends with one line and exit code 1; a bug prints its traceback."""

    def list_commands(self, _ctx: click.Context) -> list[str]:
        return list(self.commands)

    def invoke(self, ctx: click.Context) -> Any:
        """Runs the verb; a known error becomes one line."""
        if isinstance(sys.stdout, io.TextIOWrapper):  # a file name may not be valid text
            sys.stdout.reconfigure(errors="backslashreplace")
        for name in BLAS_THREADS:  # for matrices this small, threads only cost time; numpy is not imported yet
            os.environ.setdefault(name, "1")
        try:
            with safe_interrupts():
                return with_room(partial(super().invoke, ctx))
        except RotorfitError as error:
            raise click.ClickException(line_of(error, LONGEST_LINE)) from error
        except KeyboardInterrupt:
            from rotorfit.core import parallel

            if parallel.abandoned():  # they would hold the process until they are done
                click.echo("Aborted!", err=True)
                sys.stdout.flush()
                os._exit(1)
            raise
        except BrokenPipeError:  # the reader has closed the pipe: click ends quietly
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
