"""rotorfit with one row more in four tables: what the recipes of CONTRIBUTING add. Each argument is a command line."""

import json
import shlex
import sys
from pathlib import Path

from click.testing import CliRunner

from rotorfit.estimation.methods import METHODS, Method
from rotorfit.exports.formats import FORMATS as EXPORTS
from rotorfit.exports.formats import Format as Export
from rotorfit.files.logs.formats import FORMATS as LOGS
from rotorfit.files.logs.formats import Format as LogFormat
from rotorfit.flying.links import LINKS, LinkKind

TOYS = Path(__file__).parent
sys.path.append(str(TOYS.parent))
LOGS["toy"] = LogFormat("Toy log", ".toy", "toy_format")  # type: ignore[index]
METHODS["toy"] = Method("faith in round numbers", "toy_estimator:estimate")  # type: ignore[index]
LINKS["toy"] = LinkKind("toy:ADDRESS", "toy_link")  # type: ignore[index]
EXPORTS["toy"] = Export(".txt", "a toy", str(TOYS / "toy.txt.j2"), "How many axes there are.")  # type: ignore[index]

# Only now: the command line reads the tables when it is imported.
from rotorfit.app.cli import main  # noqa: E402
from rotorfit.app.web.wire import constants_mapping  # noqa: E402
from test_documents import undocumented  # noqa: E402


def said(words: list[str]) -> str:
    """What one command line prints, or the answer to one of two further questions."""
    if words == ["studio", "lists"]:
        return json.dumps(constants_mapping())
    if words == ["not", "documented"]:
        return json.dumps(sorted(undocumented()))
    return CliRunner().invoke(main, words).stdout


print(json.dumps([said(shlex.split(line)) for line in sys.argv[1:]]))
