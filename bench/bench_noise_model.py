"""Does the disturbance earn a damping of its own? Simulated flights that obey the tied form, and real ones.

    python bench/bench_noise_model.py [FLIGHTS]

Tied: the disturbance is a force with a memory of its own that acts through the vehicle's damping b, so one of its two
poles is b. Own (the default): both poles are free. On simulated flights (`designs.py`, z and yaw, open and closed loop)
the tied form is the truth: what does freedom cost? Intervals of both are the plain ones, estimate +- t standard errors.
Results: bench/noise_model.json.
"""

import json
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from designs import Design, bounds, designs, flown, truth_of
from rotorfit.estimate import free_of
from rotorfit.frames import AXES, Array
from rotorfit.likelihood import START_LEVELS, Point, inverted, restriction, score
from rotorfit.maximum import Optimum, climb, maximise
from rotorfit.model import COEFFICIENTS
from rotorfit.modes import start_point
from rotorfit.profile import quantile
from rotorfit.record import Record, record

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
    Path(__file__).with_name("noise_model.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
