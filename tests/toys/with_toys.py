"""rotorfit with one row more in four tables: what the recipes of CONTRIBUTING add. Arguments as those of `rotorfit`."""

import json
import sys
from pathlib import Path

from rotorfit.estimation.methods import METHODS, Method
from rotorfit.exports.formats import FORMATS as EXPORTS
from rotorfit.exports.formats import Format as Export
from rotorfit.files.logs.formats import FORMATS as LOGS
from rotorfit.files.logs.formats import Format as LogFormat
from rotorfit.flying.links import LINKS, LinkKind

TOYS = Path(__file__).parent
LOGS["toy"] = LogFormat("Toy log", ".toy", "toy_format")  # type: ignore[index]
METHODS["toy"] = Method("faith in round numbers", "toy_estimator:estimate")  # type: ignore[index]
LINKS["toy"] = LinkKind("toy:ADDRESS", "toy_link")  # type: ignore[index]
EXPORTS["toy"] = Export(".txt", "a toy", str(TOYS / "toy.txt.j2"), "How many axes there are.")  # type: ignore[index]

if sys.argv[1:] == ["studio's lists"]:
    from rotorfit.app.web.wire import constants_mapping

    print(json.dumps(constants_mapping()))
elif sys.argv[1:] == ["not documented"]:
    sys.path.append(str(TOYS.parent))
    from test_documents import undocumented

    print(json.dumps(sorted(undocumented())))
else:
    from rotorfit.app.cli import main

    main()
