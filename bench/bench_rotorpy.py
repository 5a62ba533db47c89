"""Does an independent simulator agree with the virtual flight room? The same manoeuvre in both, both identified.

    python bench/bench_rotorpy.py [SECONDS]

Prints the coefficients of both logs by the law with a delay, with half of the flight's 95 % interval, their difference
in standard errors of the difference, the distance between the two paths, and that after a small step, for decreasing
step sizes of rotorpy.
Skipped where rotorpy is not installed (`pip install rotorpy`).
"""

import os
import sys
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rotorfit.core.model import Axis

os.environ.setdefault("OMP_NUM_THREADS", "1")


def main() -> None:
    if find_spec("rotorpy") is None:
        print("skipped: rotorpy is not installed; pip install rotorpy")
        return
    from rotorpy_flights import AXES, CASES, fly_both, step_gap

    duration = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    for name, gain in CASES.items():
        pair = fly_both(name, duration)
        apart = abs(pair.theirs - pair.ours.true_position).max(axis=0) * 1e3
        reach = (pair.theirs.max(axis=0) - pair.theirs.min(axis=0)) * 1e3
        print(f"\n{name}, velocity loop {gain:g}/s, {duration:g} s")
        print(
            "  paths part by at most "
            + ", ".join(f"{a:.1f} of {r:.0f} mm on {axis}" for a, r, axis in zip(apart, reach, AXES, strict=True))
        )
        gaps = ", ".join(f"{step_gap(name, h):.2%} ({h * 1e3:g} ms)" for h in (0.002, 0.001, 0.0005))
        print(f"  after a small step they part by {gaps}, by how often rotorpy's loops look")
        print(f"  {'':12}{'room':>20}{'rotorpy':>20}{'difference':>12}  in s.e.")
        for axis in AXES:
            print_axis(axis, *(found[axis] for found in pair.found))


def print_axis(axis: str, ours: "Axis", theirs: "Axis") -> None:
    for what in ("input", "damping", "delay"):
        a, b = getattr(ours.predictor, what), getattr(theirs.predictor, what)
        wa, wb = half_width(ours, what), half_width(theirs, what)
        both = f"{a:11.4f} +- {wa:.4f}{b:11.4f} +- {wb:.4f}"
        print(f"  {axis + ' ' + what:12}{both}{b - a:+12.4f}  {1.96 * (b - a) / (wa**2 + wb**2) ** 0.5:+.2f}")
    a, b = ours.combinations["total_lag"].value, theirs.combinations["total_lag"].value
    print(f"  {axis + ' total lag':12}{a:11.4f}{'':10}{b:11.4f}{'':10}{b - a:+12.4f}")


def half_width(axis: "Axis", what: str) -> float:
    """Half of the 95 % interval of the flight; NaN where it is open."""
    low, high = axis.ci95_flight.get(what, axis.ci95[what])
    return float("nan") if low is None or high is None else (high - low) / 2


if __name__ == "__main__":
    main()
