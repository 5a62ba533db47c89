"""What the files in this folder amount to.

    PYTHONPATH=src python tests/files/version_0_1/numbers_of.py > numbers.json

In `numbers.json` the flight is that of version 0.1, and so is the motion but for the heading, which now turns x and y
at every 5 ms: in version 0.1 at the times that were asked for only, 9 mm off. Its commands were in force before the
first of them, too: here they are stated so. Its predictions are not: they come from the version whose filter adapts to
the air of a flight, which changed them all.

The files are by its command line: two flights of `rotorfit plan --card sim:bebop2 --room 6x6x4` flown on
`sim:bebop2,gusts=0.2`; `fit` of both with `--uncertainty --leave-one-out`, of the first by several methods and with
`--structure auto`; `convert --limits tilt=10deg`; `tune`; `plan --after`; `info --draft-card` for `card.toml`.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

import rotorfit
from rotorfit.dynamics import trajectory

FOLDER = Path(__file__).parent


def flight() -> Any:
    """The flight in `flight.csv` by `card.toml`."""
    return rotorfit.flight_from_log(rotorfit.read(FOLDER / "flight.csv"), rotorfit.load_card(str(FOLDER / "card.toml")))


def numbers_of() -> dict[str, Any]:
    """Motion that every model gives under steps, its predictions of the flight, and the flight itself."""
    known = flight()
    found: dict[str, Any] = {
        "flight": [*known.position[-1].tolist(), float(known.yaw[-1]), known.pose_time.size, *map(float, known.span)]
    }
    command = np.array([[0.2, 0.1, -0.3, 0.4], [-0.1, 0.3, 0.2, -0.5], [0.0, 0.0, 0.0, 0.1]])
    for path in sorted(FOLDER.glob("model*.json")):
        model = rotorfit.load(path)
        time = np.arange(0.0, 5.05, 0.05)
        motion = trajectory.simulate(model, np.array([0.0, 1.0, 2.5]), command, time, before=command[0])
        found[path.name] = {"pose": motion.pose[::20].tolist(), "velocity": motion.velocity[::20].tolist()}
        scores = rotorfit.validate(model, [known], (1.0,)).flights[0].axes
        found[path.name]["predictions"] = {
            axis: [score.horizons["1"].velocity_rmse, score.horizons["1"].position_rmse]
            for axis, score in scores.items()
        }
    return found


if __name__ == "__main__":
    print(json.dumps(numbers_of(), indent=1))
