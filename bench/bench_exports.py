"""Difference of every export's motion from that of the model, and the time of a step of the C predictor.

    python bench/bench_exports.py MODEL

Random commands over 20 s from a moving state (seed 3), at a fixed step and at irregular stamps, compared with
`rotorfit.simulate` on a grid of 0.25 ms. Formats whose program or package is missing are skipped and named. The time of
a step needs a quiet machine.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from export_motion import Drive, drive, integrated, reference
from exported import RUNS, STRAIGHT, WARNINGS, compiled, deviation, missing, run_numpy
from rotorfit.core.errors import ExportError
from rotorfit.core.model import Model
from rotorfit.exports import export
from rotorfit.files.models import load

SEED = 3
STEPS = 1_000_000
DRIVES = {"0.02 s": 0.02, "0.05 s": 0.05, "irregular": 0.0}

TIMED = """
#include <stdio.h>
#include <time.h>
#include "NAME.h"

int main(void)
{
    const double still[4] = {0.0, 0.0, 0.0, 0.0};
    double command[4] = {0.2, -0.1, 0.1, 0.3};
    NAME_model model;
    clock_t start;
    long k;

    NAME_start(&model, still, still, still);
    start = clock();
    for (k = 0; k < STEPS; k++) {
        command[0] = (k / 50) % 2 ? 0.2 : -0.2;
        NAME_step(&model, command, NULL);
    }
    printf("%.0f %g\\n", 1e9 * (double)(clock() - start) / CLOCKS_PER_SEC / STEPS, model.state[0]);
    return 0;
}
"""


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit("usage: python bench/bench_exports.py MODEL")
    model = load(sys.argv[1])
    print("largest deviation over 20 s, m and rad | m/s and rad/s, from rotorfit.simulate")
    print("| format | heading | " + " | ".join(DRIVES) + " |")
    for to in RUNS:
        if lacking := missing(to):
            print(f"| {to} | skipped: {lacking} is not there |")
            continue
        row(model, to)
    given = drive(SEED, 0.0)
    off = np.abs(reference(model, given) - integrated(model, given)).max(axis=0)
    print(f"the reference itself, from DOP853 at 1e-12, turning: {off[:4].max():.1e} | {off[4:].max():.1e}")
    coarser_delays(model)
    with tempfile.TemporaryDirectory() as folder:
        off = deviation(model, "gazebo", Path(folder), drive(SEED, 0.02, turning=False))
    print(f"gazebo at a heading of 0.7 rad: off by {off[0]:.2f} m")
    if missing("c"):
        return print("gcc is not there: no time of a step")
    with tempfile.TemporaryDirectory() as folder:
        program = compiled(export(model, "c", name="bebop"), Path(folder), TIMED.replace("STEPS", str(STEPS)))
        return print(f"a step of 0.02 s in C, gcc -O2: {output(program)} ns; warnings with {' '.join(WARNINGS)}: none")


def row(model: Model, to: str) -> None:
    """One format, at every way of sending commands."""
    cells = []
    straight = to in STRAIGHT
    for dt in DRIVES.values():
        given = drive(SEED, dt, turning=not straight, heading=0.0 if to == "gazebo" else 0.7)
        if to == "rotorpy" and not dt:
            cells.append("fixed step only")
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                off = deviation(model, to, Path(folder), given)
            except ExportError as error:
                return print(f"| {to} | {error} |")
        cells.append(f"{off[:2].max():.1e}, {off[2:].max():.1e}")
    heading = "0" if to == "gazebo" else "fixed" if straight else "turning"
    return print(f"| {to} | {heading} | " + " | ".join(cells) + " |")


def coarser_delays(model: Model) -> None:
    """What the exact delay is worth: the same with delays rounded to whole samples."""
    for dt in (0.02, 0.05):
        given: Drive = drive(SEED, dt)
        with tempfile.TemporaryDirectory() as folder:
            made = export(model, "numpy", dt=dt, round_delay=True, name="bebop")
            off = np.abs(run_numpy(made, Path(folder), given) - reference(model, given)).max(axis=0)
        print(f"delays rounded to {dt:g} s: off by {off[:3].max():.3f} m, {off[3]:.3f} rad, {off[4:7].max():.3f} m/s")


def output(program: Path) -> str:
    import subprocess

    return subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout.split()[0]


if __name__ == "__main__":
    main()
