"""How do time and memory grow with the length of a flight?

    python bench/bench_length.py [MINUTES ...]        by default 1, 3, 10 and 30

A simulated flight in closed loop, turning, 120 poses a second; fitted on all axes by the default laws and by
`first_order_delay`, then validated on itself. Each task in a process of its own, compiled before: processor seconds of
the task alone, and the largest memory of its process. One thread.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

Array = np.ndarray
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
TASKS = ("fit", "fit first_order_delay", "validate")


def measured(task: str, minutes: float) -> tuple[float, float]:
    """Processor seconds and megabytes of one task."""
    from peers.flights import random_steps
    from rotorfit.assessment.validation import validate
    from rotorfit.core.flight_data import Flight
    from rotorfit.estimation.fitting import fit
    from rotorfit.files.cards import load_card
    from rotorfit.flights.assemble import flight_from_log
    from rotorfit.simulation.paper_vehicle import GAMMA_B, Controller, Truth, as_log, simulate_flight

    truth = replace(Truth(), gamma=GAMMA_B, delay=(0.2, 0.2, 0.12, 0.1), wind_sigma=(0.1, 0.1, 0.05, 0.02))

    def excitation(t: Array) -> Array:  # as long as one likes: it begins again every four minutes
        return random_steps(np.mod(t, 240.0), seed=7, amplitude=(0.3, 0.3, 0.3, 0.2))

    def flown(seconds: float) -> Flight:
        flight = simulate_flight(truth, excitation, seconds, 7, controller=Controller())
        return flight_from_log(as_log(flight), load_card("rotorfit-demo"))

    def work(flight: Flight) -> Callable[[], Any]:
        if task == "validate":
            return partial(validate, fit([flown(30.0)], structure="first_order_delay").model, [flight])
        return partial(fit, [flight], structure="averaged" if task == "fit" else task.split()[1])

    work(flown(20.0))()  # compiles
    todo = work(flown(60.0 * minutes))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    start = time.process_time()
    todo()
    taken = time.process_time() - start
    return taken, max(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, before)


def main() -> None:
    if len(sys.argv) == 4 and sys.argv[1] == "--one":
        print(json.dumps(measured(sys.argv[2], float(sys.argv[3]))))
        return
    lengths = [float(one) for one in sys.argv[1:]] or [1.0, 3.0, 10.0, 30.0]
    print("| minutes | " + " | ".join(TASKS) + " |\n|--:|" + "--:|" * len(TASKS))
    for minutes in lengths:
        cells = []
        for task in TASKS:
            command = [sys.executable, __file__, "--one", task, str(minutes)]
            out = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=os.environ | THREADS)
            seconds, megabytes = json.loads(out.stdout)
            cells.append(f"{seconds:.1f} s, {megabytes:.0f} MB")
        print(f"| {minutes:g} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
