"""Prediction by PySINDy, SysIdentPy, N4SID, plain regression and rotorfit, on the same flights.

    python bench/bench_peers.py [PATTERN]

PATTERN selects sets by a part of their name, such as `simulated` or `bebop2-wsu X`; then no file is written. Prints a
table, and writes peers.json beside this file and the section "Peers" of docs/benchmarks.md.

All packages fit the same training flights and predict the same test flights by the protocol of `forecast`: 2 s for the
state, starts every 0.5 s, only commands after a start. Settings of the peers are chosen on the training flights alone,
by the scores that are compared (`peers.tuning`); settings in peers.json that were chosen with the same version of a
package are reused. Delete the file to choose all of them again.
"""

import os
import sys

for thread in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(thread, "1")  # read when numpy is first imported, below

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from peers.flights import Case, real_cases, simulated_cases
from peers.loop import later_command
from peers.packages import PEERS
from peers.series import HELD_OVER, RATES, Series, axis_series, between, grid_of, pieces, start_samples, to_poses
from peers.table import RAN_AWAY, document, print_case
from peers.tuning import Forecast, Peer, Setting, chosen, fitted
from rotorfit.assessment.paired import paired_test
from rotorfit.assessment.validation import dynamics_from_model, paper_dynamics
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import Model
from rotorfit.core.results import AxisScore, Quantity, StartErrors
from rotorfit.dynamics.protocol import (
    Predictions,
    free_run_prediction,
    hold_velocity,
    predict_flight,
    score_predictions,
    start_errors,
)
from rotorfit.estimation.fitting import fit

SCORES: dict[str, tuple[Quantity, float]] = {"velocity_1s": ("velocity", 1.0), "position_5s": ("position", 5.0)}
"""What is compared, and how far ahead [s]."""

HORIZONS = tuple(horizon for _, horizon in SCORES.values())

OWN = ("ml", "auto")
"""rotorfit's rows: the default structure, and the one that the training flights earn."""

HERE = Path(__file__).resolve().parent

RESULTS = HERE / "peers.json"

Chosen = Mapping[str, tuple[Setting, Forecast]]


def earlier_settings() -> dict[tuple[str, str, str], Setting]:
    """Set, axis and peer to the setting that was chosen by the same version of the package."""
    if not RESULTS.exists():
        return {}
    earlier = json.loads(RESULTS.read_text(encoding="utf-8"))
    return {
        (one["set"], axis, peer.name): rows[peer.name]["setting"]
        for peer in PEERS
        if earlier["versions"][peer.package] == version(peer.package)
        for one in earlier["sets"]
        for axis, rows in one["axes"].items()
    }


def peer_model(
    peer: Peer, training: Mapping[int, Sequence[Series]], setting: Setting | None
) -> tuple[Setting, Forecast]:
    """The peer's model under a setting; None to choose one."""
    return (setting, fitted(peer, training[setting["rate"]], setting)) if setting else chosen(peer, training)


def training_series(flights: Sequence[Flight]) -> dict[int, list[list[Series]]]:
    """Rate to the series of each of the four axes; rates far above the poses' own are left out."""
    period = max(float(np.median(np.diff(flight.pose_time))) for flight in flights)
    out = {}
    for rate in RATES:
        if rate * period < 1.5 or rate == min(RATES):
            grids = [grid_of(flight, part, rate) for flight in flights for part in pieces(flight, HELD_OVER)]
            out[rate] = [[axis_series(grid, k) for grid in grids if grid] for k in range(4)]
    return out


def peer_predictions(models: Chosen, flight: Flight, parts: Sequence[Predictions]) -> list[Array]:
    """What a peer predicts from the starts of each part, (S, E, 2, 4).

    Where it models yaw, its own prediction turns x and y, else the measured heading. Axes without a model stand still.
    """
    return [_part_predictions(models, flight, part) for part in parts]


def _part_predictions(models: Chosen, flight: Flight, part: Predictions) -> Array:
    segment = next(s for s in flight.segments if s.start < part.start[0] <= s.end)
    longest = float(np.max(part.time[part.last - 1] - part.start))
    out = np.zeros((part.start.size, part.predicted.shape[1], 2, 4))
    turning: tuple[float, Array] | None = None
    for axis in ("yaw", "z", "x", "y"):
        if axis not in models:
            continue
        setting, forecast = models[axis]
        k, grid = AXES.index(axis), grid_of(flight, segment, setting["rate"])
        starts, steps = start_samples(part, grid), int(np.ceil(longest / grid.step - 1e-6)) + 1
        velocity = forecast(axis_series(grid, k), starts, steps)
        begin = grid.pose[starts]
        if axis == "yaw":
            nodes = np.column_stack([begin[:, 3], begin[:, 3:] + velocity.cumsum(axis=1) * grid.step])
            turning = grid.step, nodes
        if axis in ("z", "yaw"):
            direction, columns = np.ones((starts.size, steps + 1, 1)), [k]
        else:
            middle = (np.arange(steps + 1) - 0.5) * grid.step + part.start[:, None]
            heading = np.interp(middle, flight.pose_time, flight.yaw)
            if turning:
                ahead = (middle[:, 1:] - part.start[:, None]) / turning[0]
                own = between(turning[1][..., None], ahead)[..., 0]
                # A yaw that has run away says nothing of x and y: they are turned as measured, to the peer's advantage.
                heading[:, 1:] = np.where(np.abs(own - heading[:, 1:]) < np.pi, own, heading[:, 1:])
            c, s = np.cos(heading), np.sin(heading)
            direction, columns = np.stack([c, s] if axis == "x" else [-s, c], axis=-1), [0, 1]
        moved, speed = to_poses(part, grid, k, velocity, direction)
        out[:, :, 0, columns] += moved
        out[:, :, 1, columns] += speed
        if axis != "y" or "x" not in models:
            out[:, :, 0, columns] += begin[:, None, columns]
    # What has run away is kept finite, so that turning it does not make a NaN, which counts as not measured.
    out[~(np.abs(out) < 10 * RAN_AWAY)] = 10 * RAN_AWAY
    return out


def baselines(model: Model, flight: Flight, parts: Sequence[Predictions]) -> dict[str, list[Array]]:
    """rotorfit's own predictions, the held velocity, and the paper's coefficients from the same states."""
    gamma = np.array([np.nan if value is None else value for value in model.paper])
    return {
        "ml": [part.predicted for part in parts],
        "hold": [hold_velocity(part) for part in parts],
        "coast": [free_run_prediction(flight, part, gamma[0::2], gamma[1::2]) for part in parts],
    }


def run(case: Case, settings: Mapping[tuple[str, str, str], Setting]) -> dict[str, Any]:
    """Everything about one set: per axis and method the scores, the setting, and the paired test against ml."""
    training, test = case.make()
    model, auto = fit(training).model, fit(training, structure="auto").model
    axes = [axis for axis in case.axes if model.axes[axis].predictor]
    series = training_series(training)
    models: dict[str, Chosen] = {
        peer.name: {
            axis: peer_model(
                peer,
                {rate: lines[AXES.index(axis)] for rate, lines in series.items()},
                settings.get((case.name, axis, peer.name)),
            )
            for axis in axes
        }
        for peer in PEERS
    }
    dynamics, horizon = dynamics_from_model(model), max(HORIZONS)
    methods = (*OWN, "hold", "paper", "coast", *models)
    if case.truth:
        methods = (*methods, "truth")
    errors: dict[str, list[dict[str, StartErrors]]] = {name: [] for name in methods}
    scores: dict[str, list[Mapping[str, AxisScore]]] = {name: [] for name in methods}
    for flight in test:
        parts = predict_flight(flight, dynamics, horizon)
        predicted = baselines(model, flight, parts)
        predicted |= {name: peer_predictions(models[name], flight, parts) for name in models}
        own_parts = dict.fromkeys(methods, parts)
        own_parts["auto"] = predict_flight(flight, dynamics_from_model(auto), horizon)
        own_parts["paper"] = predict_flight(flight, paper_dynamics(model), horizon)
        for name in ("auto", "paper"):
            predicted[name] = [part.predicted for part in own_parts[name]]
        if case.truth:
            predicted["truth"] = [part.predicted for part in predict_flight(flight, case.truth, horizon, adapt=False)]
        for name, values in predicted.items():
            scores[name].append(score_predictions(own_parts[name], values, HORIZONS))
            errors[name].append({f"{h:g}": start_errors(own_parts[name], values, h) for h in HORIZONS})
    return {
        "set": case.name,
        "kind": case.kind,
        "axes": {axis: _axis_result(axis, errors, scores, models) for axis in axes},
        "structures": {axis: [one.axes[axis].structure for one in (model, auto)] for axis in axes},
        "loop": {axis: round(later_command(series[min(series)][AXES.index(axis)]), 1) for axis in axes},
    }


def _axis_result(
    axis: str,
    errors: Mapping[str, Sequence[Mapping[str, StartErrors]]],
    scores: Mapping[str, Sequence[Mapping[str, AxisScore]]],
    models: Mapping[str, Chosen],
) -> dict[str, Any]:
    out = {}
    for name in errors:
        row: dict[str, Any] = {}
        for score, (what, horizon) in SCORES.items():
            flights = [flight[axis].horizons[f"{horizon:g}"] for flight in scores[name]]
            row[score] = [getattr(flight, f"{what}_rmse") for flight in flights]
            row[f"n_{score}"] = [flight.n for flight in flights]
        if name in models:
            row["setting"] = dict(models[name][axis][0])
        for own in OWN:
            if name != own and (own == "ml" or name not in OWN):
                row[f"{own}_against"] = _against(own, name, errors, axis)
        out[name] = row
    return out


def _against(
    own: str, name: str, errors: Mapping[str, Sequence[Mapping[str, StartErrors]]], axis: str
) -> dict[str, dict[str, Any] | None]:
    """The paired test of one of rotorfit's rows against another; a model that ran away needs none."""
    k = AXES.index(axis)
    tests = paired_test((own, name), errors[own], errors[name], [(axis,)] * len(errors[own])).axes[axis]
    out: dict[str, dict[str, Any] | None] = {}
    for score, (what, horizon) in SCORES.items():
        pooled = tests[f"{horizon:g}"][what].pooled
        largest = max(float(np.max(e[f"{horizon:g}"].position[:, k], initial=0.0)) for e in errors[name])
        out[score] = {"verdict": "better", "ran_away": True} if largest > RAN_AWAY**2 else pooled and asdict(pooled)
    return out


def main() -> None:
    pattern = sys.argv[1] if len(sys.argv) > 1 else ""
    results, began, settings = [], time.perf_counter(), earlier_settings()
    real = list(real_cases())
    if not real:
        print("recorded flights are not there (../shared/data): simulated ones only")
    for case in chain(simulated_cases(), real):
        if pattern in case.name:
            results.append(run(case, settings))
            print_case(results[-1])
    print(f"{time.perf_counter() - began:.0f} s")
    if pattern or not real:
        return
    packages = ("rotorfit", *(peer.package for peer in PEERS), "numpy", "scipy")
    result = {
        "date": datetime.now(tz=UTC).date().isoformat(),
        "versions": {package: version(package) for package in packages},
        "sets": results,
    }
    RESULTS.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    document(result, HERE.parent / "docs" / "benchmarks.md")


if __name__ == "__main__":
    main()
