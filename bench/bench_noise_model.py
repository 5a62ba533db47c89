"""Does the disturbance need a damping of its own? Simulated flights that obey the tied form, and real ones.

    python bench/bench_noise_model.py [FLIGHTS]

Tied: the disturbance is a force with a memory of its own that acts through the vehicle's damping b, so one of its two
poles is b. Own (the default): both poles are free. On simulated flights (`designs.py`, z and yaw, open and closed loop)
the tied form is the truth: how much precision does the free form lose? Intervals of both are the plain ones, estimate
+- t standard errors. On recorded flights, where available, the truth is unknown: which form predicts held-out flights
better? Results: bench/noise_model.json.
"""

import json
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from designs import Design, bounds, designs, flown, truth_of
from peers.flights import Case, real_cases
from rotorfit.assessment.paired import paired_test
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import START_LEVELS
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.results import StartErrors
from rotorfit.dynamics.protocol import predict_flight, start_errors
from rotorfit.estimation.likelihood.axis_estimate import estimate_axis, free_of
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, climb, maximise
from rotorfit.estimation.likelihood.likelihood import inverted, restriction, score
from rotorfit.estimation.likelihood.optima import dynamics_of, start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.profile import quantile

PASSES = 40


def tied(records: Sequence[Record], start: Point) -> Optimum:
    """Maximum of the likelihood of one axis with one pole of the disturbance at the vehicle's damping.

    Fisher scoring over (g, log b, tau, trims, starts, log q, log r, log lambda), with alpha = b + lambda and
    kappa = 4 b lambda / (b + lambda)^2; gradient and information by the chain rule.
    """
    n, point = start.n, _with_pole(start, 0.0)
    restricted = restriction(records, point, np.ones(n + 4, bool))
    best, pole, free = score(records, point, restricted), 0.0, np.ones(n + 3, bool)
    for _ in range(PASSES):
        J = _jacobian(point, pole)
        gradient, information = J.T @ best.gradient, J.T @ best.information @ J
        step = inverted(information + 1e-6 * np.eye(n + 3), free) @ gradient
        step /= max(1.0, np.abs(step[1]) / 1.0, np.abs(step[2]) / 0.08, np.abs(step[-3:]).max() / 2.0)
        if step @ gradient < 1e-3:
            break
        for _ in range(8):
            trial_pole = float(np.clip(pole + step[-1], *np.log([0.05, 50.0])))
            moved = point.moved(np.append(step[:-1], [0.0, 0.0]))
            trial = _with_pole(moved, trial_pole)
            result = score(records, trial, restricted)
            if result.objective > best.objective:
                break
            step = 0.3 * step
        else:
            break
        point, best, pole = trial, result, trial_pole
    J = _jacobian(point, pole)
    inverse = inverted(J.T @ best.information @ J, free)
    return Optimum(point, best, np.ones(n + 4, bool), restricted, inverse, 0.0, 0)


def _with_pole(point: Point, pole: float) -> Point:
    b, other = float(np.exp(point.log_damping[0])), float(np.exp(pole))
    levels = point.levels.copy()
    levels[0, 2:] = np.log([b + other, 4 * b * other / (b + other) ** 2])
    return replace(point, levels=levels)


def _jacobian(point: Point, pole: float) -> Array:
    """Of all parameters by those of the tied form."""
    n, b, other = point.n, float(np.exp(point.log_damping[0])), float(np.exp(pole))
    J = np.zeros((n + 4, n + 3))
    J[np.arange(n + 2), np.arange(n + 2)] = 1.0
    share = b / (b + other)
    J[n + 2, 1], J[n + 2, n + 2] = share, 1 - share
    J[n + 3, 1], J[n + 3, n + 2] = 1 - 2 * share, 2 * share - 1
    return J


def rows_of(design: Design) -> list[tuple[str, str, float, float, bool]]:
    """Form, coefficient, error and half-width in Cramer-Rao bounds, and whether the interval holds the truth."""
    flight, out = flown(design), []
    bound = bounds(design, flight)
    for axis in ("z", "yaw"):
        rec = record(flight, (axis,))
        assert rec is not None
        truth = truth_of(design, axis)
        start = replace(start_point([rec], truth[2], truth[1], START_LEVELS[None]), gain=truth[:1])
        own = climb([rec], start, free_of([rec], [True]))
        own = maximise([rec], own.point, own.free, own.inverse)
        for form, best in (("own", own), ("tied", tied([rec], own.point))):
            inverse = inverted(best.score.information, best.free) if form == "own" else best.inverse
            value = best.point.flat()[:3] - np.array([truth[0], np.log(truth[1]), truth[2]])
            for j, name in enumerate(COEFFICIENTS):
                scale = bound[axis][j] / (truth[1] if name == "damping" else 1.0)
                half = quantile(best, np.eye(best.point.n)[j]) * float(np.sqrt(inverse[j, j]))
                out.append(
                    (form, f"{axis}.{name}", value[j] / scale, half / (1.96 * scale), bool(abs(value[j]) < half))
                )
    return out


def predicted(case: Case) -> list[tuple[str, str, str, str, float, float, float, float]]:
    """Errors of both forms on the test flights of a set, and own less tied with its standard error and p."""
    training, test = case.make()
    out = []
    for axis in case.axes:
        serving = [f for f in training if axis in f.axes and np.any(f.command[:, AXES.index(axis)])]
        records = [rec for f in serving if (rec := record(f, (axis,)))]
        if not records or not all(rec.held for rec in records):
            continue
        estimate = estimate_axis(serving, axis, True)
        if not estimate.excited:
            continue
        own = estimate.optimum
        forms = {"own": own, "tied": tied(records, own.point)}
        errors: dict[str, list[dict[str, StartErrors]]] = {name: [] for name in forms}
        for name, best in forms.items():
            if name == "tied":
                best = replace(best, inverse=own.inverse)
            for flight in test:
                parts = predict_flight(flight, dynamics_of((axis,), best), 5.0, (axis,))
                runs = [part.predicted for part in parts]
                errors[name].append({f"{h:g}": start_errors(parts, runs, h) for h in (1.0, 5.0)})
        pairs = paired_test(("own", "tied"), errors["own"], errors["tied"], [(axis,)] * len(test))
        for horizon, what in (("1", "velocity"), ("5", "position")):
            pooled = pairs.axes[axis][horizon][what].pooled if axis in pairs.axes else None
            rmse = [_rmse(errors[name], horizon, what, AXES.index(axis)) for name in forms]
            stderr, p = (pooled.rmse_stderr, pooled.p) if pooled else (None, None)
            out.append((case.name, axis, what, pooled.verdict if pooled else "too_short", *rmse, stderr, p))
    return out


def _rmse(flights: Sequence[dict[str, StartErrors]], horizon: str, what: str, k: int) -> float:
    errors = [flight[horizon] for flight in flights]
    if what == "position":
        return float(np.sqrt(np.mean(np.concatenate([e.position[:, k] for e in errors]))))
    total, steps = (np.concatenate([getattr(e, name)[:, k] for e in errors]).sum() for name in ("velocity", "steps"))
    return float(np.sqrt(total / steps))


def print_predicted(rows: Sequence[tuple[str, str, str, str, float, float, float | None, float | None]]) -> None:
    print(
        f"\nrecorded flights, cm/s at 1 s and cm at 5 s (yaw 0.01 rad)\n{'set':46}{'axis':5}{'':9}{'own':>7}{'tied':>7}"
    )
    for name, axis, what, verdict, own, other, stderr, p in rows:
        tail = "" if stderr is None or p is None else f"  +- {100 * stderr:.2f}, p {p:.2g}"
        print(f"{name:46}{axis:5}{what:9}{100 * own:7.2f}{100 * other:7.2f}  own is {verdict}{tail}")


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    result: dict[str, dict[str, dict[str, float]]] = {}
    with ProcessPoolExecutor() as pool:
        for loop, closed in (("open loop", False), ("closed loop", True)):
            rows = [r for part in pool.map(rows_of, designs(count, closed, seed=7), chunksize=4) for r in part]
            print(f"\n{loop}, {count} flights, truth tied")
            print(f"{'form':6}{'coefficient':14}{'bias':>7}{'rmse':>7}{'covered':>9}{'width':>7}")
            for form in ("own", "tied"):
                names = [f"{axis}.{name}" for axis in AXES[2:] for name in COEFFICIENTS]
                for name in names:
                    mine = [r for r in rows if r[:2] == (form, name)]
                    error = np.array([r[2] for r in mine])
                    row = {
                        "bias": float(error.mean()),
                        "rmse": float(np.sqrt(np.mean(error**2))),
                        "covered": float(np.mean([r[4] for r in mine])),
                        "width": float(np.mean([r[3] for r in mine])),
                    }
                    result.setdefault(f"{loop}, {form}", {})[name] = row
                    print(
                        f"{form:6}{name:14}{row['bias']:+7.2f}{row['rmse']:7.2f}{row['covered']:9.3f}{row['width']:7.2f}"
                    )
    rows = [row for case in real_cases() for row in predicted(case)]
    print_predicted(rows)
    result["recorded"] = rows  # type: ignore[assignment]
    Path(__file__).with_name("noise_model.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
