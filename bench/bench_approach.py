"""The approach to a plan's start: final distance and overshoot, over a family of vehicles.

    python bench/bench_approach.py [--count 500] [--seed 0] [--list]

Tilt-, velocity- and acceleration-commanded vehicles in equal parts, drawn as planning draws them: input and damping of
each differ from the belief of the approach by the belief's own spread; the delay is believed to be 0.15, 0.30 or 0.50 s
and is up to 0.6 s in truth, with a further lag of 0.1 s that the belief does not include; a third fly in a steady wind,
all in gusts, with trim. They begin 2 to 3 m away, in any direction, turned by up to 57 degrees.

Printed: how many arrive, and the quantiles of the final distance, of the overshoot (beyond the start of the plan, along
the line from the vehicle's first position), and of the time.
"""

import argparse
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from believed_vehicles import Case, approached, cases

KINDS = ("tilt", "velocity", "acceleration")


def one(case: Case) -> tuple[str, float, float, float]:
    with tempfile.TemporaryDirectory() as folder:
        return approached(case, Path(folder) / "log.mcap")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--list", action="store_true", help="the ten worst")
    asked = parser.parse_args()
    family = list(cases(asked.count, asked.seed))
    with ProcessPoolExecutor(2) as pool:
        found = list(pool.map(one, family, chunksize=5))
    reasons = [reason for reason, *_ in found]
    print(f"{reasons.count('completed')} of {len(found)} arrived; others: {sorted(set(reasons) - {'completed'})}")
    table = np.array([numbers for _, *numbers in found])
    for name, column in zip(("distance at the end [m]", "overshoot [m]", "time [s]"), table.T, strict=True):
        values = "  ".join(f"{np.quantile(column, q):6.3f}" for q in (0.5, 0.95, 0.99, 1.0))
        print(f"{name:24s} median, 95 %, 99 %, most: {values}")
    for kind in KINDS:
        over = [row[2] for row, case in zip(found, family, strict=True) if case.kind == kind]
        print(f"{kind:14s} most overshoot {max(over):.3f} m")
    for place in np.argsort(-table[:, 1])[: 10 * asked.list]:
        case = family[place]
        print(place, found[place], case.kind, case.plan.belief["delay"][0], case.truth.delay[:2], case.truth.gamma[:4])


if __name__ == "__main__":
    main()
