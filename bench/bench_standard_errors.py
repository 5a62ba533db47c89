"""Five standard errors compared with the observed scatter.

    python bench/bench_standard_errors.py [REPETITIONS] [FIRST_SEED]

Each repetition is three flights of 20 s that step the x command (set B, 0.15 s delay, the demo's wind and mocap),
fitted together by their law, `first_order_delay`. Cases: a disturbance of the model's kind; a wobble of 2.5 Hz and
2 mm, in bursts, not caused by any command, added to the measured pose; wind with two memories, 0.3 s and 8 s; a
position controller in the loop. Per coefficient: root mean square of each standard error over the standard deviation of
the estimates, and the share of intervals of +-1.96 of each that contain the truth.
"""

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorfit.assessment.uncertainty import with_uncertainty
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import load_card
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import Controller, Truth, as_log, simulate_flight

CASES = ("as modelled", "wobble 2.5 Hz", "two winds", "in a loop")
ERRORS = ("expected", "observed", "sandwich", "bootstrap", "scatter")
FLIGHTS, DURATION = 3, 20.0


def steps(seed: int):  # type: ignore[no-untyped-def]
    """x commands of -0.2, 0 or 0.2 that change at random about every 0.7 s."""
    rng = np.random.default_rng(seed)
    level, switch = 0.2 * rng.integers(-1, 2, 200), np.cumsum(0.7 * (0.5 + rng.random(200)))

    def command(t: Array) -> Array:
        return np.outer(level[np.searchsorted(switch, t)], [1.0, 0.0, 0.0, 0.0])

    return command


def flight(case: str, seed: int) -> Flight:
    truth, rng = Truth(), np.random.default_rng(10**6 + seed)
    if case == "two winds":
        truth = replace(truth, wind_sigma=(0.04,) * 4, wind_time=(0.3,) * 4)
    controller = Controller(0.5, 0.8) if case == "in a loop" else None
    card = load_card("rotorfit-demo")
    flown = flight_from_log(as_log(simulate_flight(truth, steps(seed), DURATION, seed, controller=controller)), card)
    t, moved = flown.pose_time, flown.position.copy()
    if case == "wobble 2.5 Hz":
        envelope = np.interp(t, np.arange(0.0, DURATION + 2.0), np.maximum(rng.standard_normal(int(DURATION) + 2), 0.0))
        moved[:, 0] += 0.002 * envelope * np.sin(2 * np.pi * 2.5 * t + rng.uniform(0, 2 * np.pi))
    if case == "two winds":
        moved[:, 0] += _slow_drift(t, rng, truth.gamma[1])
    return replace(flown, position=moved)


def _slow_drift(t: Array, rng: np.random.Generator, damping: float) -> Array:
    """Motion under an acceleration of 0.02 m/s^2 with a memory of 8 s, on the poses' stamps, by small steps."""
    grid = np.arange(0.0, t[-1] + 0.02, 0.01)
    force, p, v = 0.02 * rng.standard_normal(), 0.0, 0.0
    out = np.empty(grid.size)
    for i in range(grid.size):
        out[i] = p
        p, v = p + 0.01 * v, v + 0.01 * (force - damping * v)
        force += -0.01 / 8 * force + 0.02 * np.sqrt(2 * 0.01 / 8) * rng.standard_normal()
    return np.interp(t, grid, out)


def one(task: tuple[str, int]) -> list[list[float]] | None:
    """Per coefficient: estimate, then the five standard errors."""
    case, seed = task
    flights = [flight(case, FLIGHTS * seed + j) for j in range(FLIGHTS)]
    fitted = fit(flights, axes=("x",), structure="first_order_delay")
    if fitted.model.axes["x"].predictor is None:
        return None
    table = with_uncertainty(fitted).model.uncertainty
    assert table is not None
    known = table.axes["x"].coefficients
    rows = [[known[name].value, *(getattr(known[name], error) for error in ERRORS)] for name in COEFFICIENTS]
    return [[np.nan if value is None else value for value in row] for row in rows]


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    truth = np.array([Truth().gamma[0], Truth().gamma[1], Truth().delay[0]])
    result = {}
    print(f"{count} repetitions, seeds from {first}; error over scatter (share of +-1.96 errors that hold the truth)")
    print(f"{'case':15}{'coefficient':12}{'bias':>6}" + "".join(f"{name:>14}" for name in ERRORS))
    for case in CASES:
        with ProcessPoolExecutor() as pool:
            rows = [row for row in pool.map(one, [(case, first + i) for i in range(count)], chunksize=2) if row]
        values = np.array(rows)
        for i, name in enumerate(COEFFICIENTS):
            estimate, errors = values[:, i, 0], values[:, i, 1:]
            spread = estimate.std(ddof=1)
            ratio = np.sqrt(np.nanmean(errors**2, axis=0)) / spread
            held = np.mean(np.abs(estimate - truth[i])[:, None] <= 1.96 * errors, axis=0)
            bias = (estimate.mean() - truth[i]) / spread
            result[f"{case}: {name}"] = {
                "repetitions": len(rows),
                "scatter": spread,
                "bias": bias,
                "ratio": dict(zip(ERRORS, ratio.tolist(), strict=True)),
                "held": dict(zip(ERRORS, held.tolist(), strict=True)),
            }
            cells = "".join(f"{r:7.2f} ({100 * h:3.0f} %)" for r, h in zip(ratio, held, strict=True))
            print(f"{case:15}{name:12}{bias:+6.2f}{cells}", flush=True)
    Path(__file__).with_name("standard_errors.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
