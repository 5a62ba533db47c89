"""How long does a fit take, compared with other packages, on the same flights in the same process?

    python bench/bench_fit_speed.py

Two flights: x of 168 s of a Bebop 2 (`bebop2-wsu` X, beside the project), and 168 s simulated that excite all four
axes. Processor time, one thread, after import and compilation; the packages take turns, and the best of five turns
counts. Printed is the range of three such runs, relative to the time of N4SID for one axis of that flight in that run.

Every other package fits one setting, without a search: 20 Hz, half a second of lags or block rows of 0.75 s. rotorfit
searches the delay and computes intervals; the time of its judgement (`estimation/judgement`) is listed separately.
"""

import os
import time
import warnings

for thread in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(thread, "1")  # read when numpy is first imported, below

from collections.abc import Callable, Sequence
from functools import partial
from unittest.mock import patch

import numpy as np
from scipy.optimize import least_squares

import control
from bench_length import turning_flight
from peers.flights import REAL_FLIGHTS
from peers.packages import pysindy_fit, statsmodels_fit, subspace, sysidentpy_fit
from peers.series import Series, axis_series, grid_of
from rotorfit.core import parallel
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array
from rotorfit.estimation import fitting
from rotorfit.files.cards import load_card
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log

RATE = 20
TURNS = 5
RUNS = 3


def n4sid(series: Series) -> None:
    subspace.cache_clear()
    subspace((series,), integrated=True, rows=15).system_identification(3)


def output_error(series: Series) -> None:
    """Gain, damping, delay and trim whose simulated velocity is nearest to the measured one."""
    t = np.arange(series.y.size) * series.step

    def error(theta: Array) -> Array:
        gain, damping, delay, trim = theta
        inputs = np.stack([np.interp(t - delay, t, series.u), np.ones(t.size)])
        vehicle = control.ss([[-damping]], [[gain, trim]], [[1.0]], [[0.0, 0.0]])
        return np.asarray(control.forced_response(vehicle, t, inputs).outputs[0] - series.y)

    bounds = [-np.inf, 0.001, -0.1, -np.inf], [np.inf, 100.0, 0.6, np.inf]
    least_squares(error, [1.0, 1.0, 0.15, 0.0], bounds=bounds, x_scale=[1.0, 1.0, 0.1, 0.1])


OTHERS: dict[str, Callable[[Series], object]] = {
    "SysIdentPy, FROLS": lambda series: sysidentpy_fit(
        [series], {"outputs": 3, "inputs": 10, "degree": 1, "criterion": "bic", "terms": 15}
    ),
    "PySINDy, STLSQ": lambda series: pysindy_fit(
        [series], {"delays": (0.2,), "window": 0.3, "past": 0.1, "degree": 1, "threshold": 0.0}
    ),
    "statsmodels, ARX": lambda series: statsmodels_fit(
        [series], {"outputs": 4, "delay": 0, "inputs": 10, "constant": True}
    ),
    "python-control and SciPy, output error": output_error,
}
"""Each with settings of the kind that `bench_peers.py` chose."""


def seconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def rotorfit(flight: Flight, axes: Sequence[str], structure: str) -> tuple[float, float]:
    """Seconds without the fit's judgement of itself, and with it."""
    spent, judged = [], fitting.judged

    def timed(*args: object, **named: object) -> object:
        start = time.process_time()
        out = judged(*args, **named)
        spent.append(time.process_time() - start)
        return out

    with patch.object(fitting, "judged", timed), patch.object(parallel, "LONG", np.inf):  # one thread
        whole = seconds(lambda: fitting.fit([flight], axes=axes, structure=structure))
    return whole - sum(spent), whole


def turn(flight: Flight, lines: dict[str, Series]) -> dict[str, float]:
    """Seconds of everybody for some axes, and as `unit` those of N4SID for the first."""
    alone = [seconds(partial(n4sid, one)) for one in lines.values()]
    out = {"unit": alone[0], "nfoursid, N4SID": sum(alone)}
    for structure, words in (("first_order_delay", "`first_order_delay`"), ("averaged", "the default laws")):
        bare, whole = rotorfit(flight, tuple(lines), structure)
        out[f"rotorfit, {words}"], out[f"rotorfit, {words}, and its judgement of itself"] = bare, whole
    for name, one_fit in OTHERS.items():
        out[name] = sum(seconds(partial(one_fit, one)) for one in lines.values())
    return out


def over_unit(flight: Flight, lines: dict[str, Series]) -> dict[str, float]:
    """Best of the turns, over the best of the unit."""
    turns = [turn(flight, lines) for _ in range(TURNS)]
    best = {name: min(one[name] for one in turns) for name in turns[0]}
    return {name: value / best["unit"] for name, value in best.items() if name != "unit"}


def main() -> None:
    warnings.simplefilter("ignore")  # of short or collinear data
    path = REAL_FLIGHTS / "bebop2-wsu/Training_CT_TestDay_X.mat"
    tasks = [("four axes, simulated", turning_flight(168.0), AXES)]
    if path.exists():
        tasks.insert(0, ("x, recorded", flight_from_log(read(path), load_card("bebop2-wsu")), ("x",)))
    columns = []
    for _, flight, axes in tasks:
        grid = grid_of(flight, Segment(flight.segments[0].start, flight.segments[-1].end), RATE)
        lines = {axis: axis_series(grid, AXES.index(axis)) for axis in axes}
        turn(flight, lines)  # compiles
        columns.append([over_unit(flight, lines) for _ in range(RUNS)])
    print("| | " + " | ".join(label for label, _, _ in tasks) + " |\n|---|" + "--:|" * len(tasks))
    for name in columns[0][0]:
        cells = [f"{min(run[name] for run in runs):.2g} to {max(run[name] for run in runs):.2g}" for runs in columns]
        print(f"| {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
