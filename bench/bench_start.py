"""Time of a new process: the verbs of a first session, with compiled code in the cache, and without.

    python bench/bench_start.py [LOG] [--card CARD] [--runs N]

The verbs are `--help`, and `info`, `fit` and `validate` of LOG (default: 168 s of a Bebop 2, beside the project), each
in a process of its own; medians of N runs (default 10), in turn, so that the load of the machine affects all of them.
"Fresh" is each verb with an empty cache of compiled code: the difference from a warm run is compilation.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from time import perf_counter

CLEAN = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": ""}
"""One thread, and Python keeps its bytecode, as where it is installed: without, every start compiles all sources."""

DEFAULT = Path(__file__).resolve().parents[2] / "shared/data/bebop2-wsu/Training_CT_TestDay_X.mat"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("log", nargs="?", default=str(DEFAULT))
    parser.add_argument("--card", default="bebop2-wsu")
    parser.add_argument("--runs", type=int, default=10)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        model, kept = str(Path(folder, "model.json")), str(Path(folder, "kept"))
        verbs = {
            "--help": ["--help"],
            "info": ["info", asked.log, "--card", asked.card],
            "fit": ["fit", asked.log, "--card", asked.card],
            "validate": ["validate", model, asked.log],
        }
        run([*verbs["fit"], "-o", model], kept)
        fresh = {name: run(words, str(Path(folder, name.strip("-")))) for name, words in verbs.items()}
        for words in verbs.values():
            run(words, kept)
        rounds = [{name: run(words, kept) for name, words in verbs.items()} for _ in range(asked.runs)]
    print("verb          wall  processor   fresh: wall  processor  compiling [s]")
    for name, (first, worked) in fresh.items():
        wall, processor = (median(one[name][k] for one in rounds) for k in (0, 1))
        print(f"{name:10}{wall:8.2f}{processor:11.2f}{first:14.2f}{worked:11.2f}{worked - processor:11.2f}")


def run(words: Sequence[str], kept: str) -> tuple[float, float]:
    """Wall clock and processor time of one process [s], with its compiled code in a folder."""
    before, begun = used(), perf_counter()
    subprocess.run(
        [sys.executable, "-m", "rotorfit", *words],
        env=os.environ | CLEAN | {"NUMBA_CACHE_DIR": kept},
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return perf_counter() - begun, used() - before


def used() -> float:
    """Processor time of all processes that have ended [s]."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


if __name__ == "__main__":
    main()
