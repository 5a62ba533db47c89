"""How do time and memory grow with the length of a flight?

    python bench/bench_length.py [MINUTES ...]        by default 1, 3, 10 and 30

A simulated flight in closed loop, turning, 120 poses a second; fitted on all axes by the default laws and by
`first_order_delay`, then validated. Each task runs in a process of its own, after compilation, on a flight simulated by
another process: seconds on the clock of the task alone, seconds of all processors in brackets, and the peak memory of
its process, including the libraries and the flight itself. Linear algebra has one thread.
"""

import json
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
TASKS = ("fit", "fit first_order_delay", "validate")


def turning_flight(seconds: float) -> Any:
    """A simulated flight in closed loop, all four axes stepped at random, as long as one likes."""
    from peers.flights import random_steps
    from rotorfit.files.cards import load_card
    from rotorfit.flights.assemble import flight_from_log
    from rotorfit.simulation.paper_vehicle import GAMMA_B, Controller, Truth, as_log, simulate_flight

    truth = replace(Truth(), gamma=GAMMA_B, delay=(0.2, 0.2, 0.12, 0.1), wind_sigma=(0.1, 0.1, 0.05, 0.02))

    def excitation(t: Array) -> Array:  # begins again every four minutes
        return random_steps(np.mod(t, 240.0), seed=7, amplitude=(0.3, 0.3, 0.3, 0.2))

    flight = simulate_flight(truth, excitation, seconds, 7, controller=Controller())
    return flight_from_log(as_log(flight), load_card("rotorfit-demo"))


def fly(seconds: float, to: Path) -> None:
    """Simulates a flight and writes it, with a model of half a minute of it."""
    from rotorfit.estimation.fitting import fit

    model = fit([turning_flight(30.0)], structure="first_order_delay").model
    to.write_bytes(pickle.dumps((turning_flight(seconds), model)))


def measured(task: str, short: Path, long: Path) -> tuple[float, float, float]:
    """Seconds on the clock, processor seconds and megabytes of one task; the short flight has it compiled."""
    from rotorfit.assessment.validation import validate
    from rotorfit.estimation.fitting import fit

    def work(path: Path) -> Callable[[], Any]:
        flight, model = pickle.loads(path.read_bytes())
        if task == "validate":
            return partial(validate, model, [flight])
        return partial(fit, [flight], structure="averaged" if task == "fit" else task.split()[1])

    work(short)()
    todo = work(long)
    begun, start = time.perf_counter(), time.process_time()
    todo()
    clock, worked = time.perf_counter() - begun, time.process_time() - start
    return clock, worked, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    if sys.argv[1:2] == ["--fly"]:
        fly(float(sys.argv[2]), Path(sys.argv[3]))
        return
    if sys.argv[1:2] == ["--one"]:
        print(json.dumps(measured(sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4]))))
        return
    lengths = [float(one) for one in sys.argv[1:]] or [1.0, 3.0, 10.0, 30.0]
    print("| minutes | " + " | ".join(TASKS) + " |\n|--:|" + "--:|" * len(TASKS), flush=True)

    def run(*words: str) -> str:
        command = [sys.executable, __file__, *words]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=os.environ | THREADS).stdout

    with tempfile.TemporaryDirectory() as folder:
        short, long = (str(Path(folder) / name) for name in ("short", "long"))
        run("--fly", "20", short)
        for minutes in lengths:
            run("--fly", str(60.0 * minutes), long)
            cells = []
            for task in TASKS:
                clock, worked, megabytes = json.loads(run("--one", task, short, long))
                cells.append(f"{clock:.1f} s ({worked:.1f}), {megabytes:.0f} MB")
            print(f"| {minutes:g} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
