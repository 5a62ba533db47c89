"""Do the intervals contain the measured response of a real autopilot? ArduCopter in software, sines and steps as truth.

    python bench/bench_autopilot.py [FOLDER_OF_arducopter-sitl] [--structures averaged,...] [--flights s01,...]

For every flight and axis: steady gain, total lag, and gain and delay at 1, 2, 3 and 4.5 rad/s, each with the model's
own 95 % interval. The truth was measured without rotorfit (truth.json); its own error (gain 0.01, delay 5 ms, 10 ms
below 2 rad/s) is added to the ends of the intervals in the second figure of each pair. The poses of these flights are
stamped early; the reader corrects their clock. The true steady gain is that of the steps; the true total lag is the
delay at 0.5 rad/s, extrapolated to 0 by a straight line in the square of the frequency. Prints Markdown.
"""

import argparse
import json
import time
from collections import defaultdict
from pathlib import Path

from rotorfit.app.workflows import load_flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import Interval, Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.log_span import LogSpan
from sine_response import sine_response

DEFAULT = Path(__file__).resolve().parents[2] / "shared/data/arducopter-sitl"
FREQUENCIES = (1.0, 2.0, 3.0, 4.5)
GAIN_ERROR, DELAY_ERROR, SLOW_ERROR = 0.01, 0.005, 0.010
SMALL = ("s01", "s02", "s04", "s06")

Row = tuple[str, float, float, Interval, float]
"""What, truth, value, interval, and the error of the truth."""


def truth_of(folder: Path) -> dict[str, dict[str, float]]:
    """Of each axis: `steady_gain`, `total_lag`, and gain and delay by frequency."""
    raw = json.loads((folder / "truth.json").read_text())
    out: dict[str, dict[str, float]] = defaultdict(dict)
    for one in raw["sine"]:
        out[one["axis"]][f"gain {one['w']:g}"] = one["gain_from_pose"]
        out[one["axis"]][f"delay {one['w']:g}"] = one["delay_from_pose"]
    for one in raw["step"]:
        out[one["axis"]]["steady_gain"] = one["final"]
    for known in out.values():
        slow, fast = known["delay 0.5"], known["delay 1"]
        known["total_lag"] = slow - (fast - slow) / 3
    return out


def rows_of(model: Model, axis: str, truth: dict[str, float]) -> list[Row]:
    """Everything that is compared of one axis."""
    known = model.axes[axis]
    out: list[Row] = []
    for name, error in (("steady_gain", GAIN_ERROR), ("total_lag", SLOW_ERROR)):
        part = known.combinations.get(name)
        if part is not None:
            out.append((name, truth[name], part.value, part.ci95, error))
    for w in FREQUENCIES if known.predictor else ():
        told = sine_response(model, axis, w)
        out.append((f"gain {w:g}", truth[f"gain {w:g}"], told.gain, told.gain_ci95, GAIN_ERROR))
        error = SLOW_ERROR if w < 2 else DELAY_ERROR
        out.append((f"delay {w:g}", truth[f"delay {w:g}"], told.delay, told.delay_ci95, error))
    return out


def holds(row: Row, error: float) -> bool:
    _, true, _, (low, high), _ = row
    return (low is None or low - error <= true) and (high is None or true <= high + error)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path, default=DEFAULT)
    parser.add_argument("--structures", default="first_order_delay,averaged")
    parser.add_argument("--flights", default=",".join(SMALL))
    parser.add_argument("--rows", action="store_true", help="print every comparison")
    args = parser.parse_args()
    if not args.folder.is_dir():
        print(f"skipped: {args.folder} is not there; give the folder of arducopter-sitl")
        return
    truth = truth_of(args.folder)
    found: dict[str, list[tuple[str, str, Row]]] = defaultdict(list)
    for name in args.flights.split(","):
        flight = load_flight(LogSpan(str(args.folder / f"{name}.mcap"), (None, None)))
        for structure in args.structures.split(","):
            start = time.perf_counter()
            model = fit([flight], structure=structure).model
            print(f"{name} {structure}: {time.perf_counter() - start:.1f} s", flush=True)
            for axis in AXES:
                known = model.axes[axis]
                laws = ", ".join(f"{law.structure} {law.weight:.2f}" for law in known.laws) or known.structure
                print(f"  {axis}: {laws}; status {dict(known.status)}")
                found[structure] += [(name, axis, row) for row in rows_of(model, axis, truth[axis])]
    if args.rows:
        for structure, rows in found.items():
            for name, axis, row in rows:
                what, true, value, (low, high), error = row
                ends = ", ".join("open" if end is None else f"{end:.3f}" for end in (low, high))
                mark = "" if holds(row, 0.0) else (" near" if holds(row, error) else " MISS")
                print(f"{structure} {name} {axis} {what}: {value:.3f} [{ends}], measured {true:.3f}{mark}")
    print("\n| structure | what | held | held with the truth's error | of |\n|---|---|---|---|---|")
    for structure, rows in found.items():
        for what, wanted in (
            ("steady gain", ("steady_gain",)), ("total lag", ("total_lag",)), ("gains", ("gain",)),
            ("delays", ("delay",)), ("all", ("",)),
        ):  # fmt: skip
            some = [row for _, _, row in rows if row[0].startswith(wanted)]
            plain, wide = sum(holds(row, 0.0) for row in some), sum(holds(row, row[4]) for row in some)
            print(f"| `{structure}` | {what} | {plain} | {wide} | {len(some)} |")


if __name__ == "__main__":
    main()
