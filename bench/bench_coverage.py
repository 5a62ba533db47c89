"""Are the intervals true? Simulated training flights of the demo's kind, fitted like any log.

    python bench/bench_coverage.py [FLIGHTS] [FIRST_SEED]

Each repetition is the demo's three training flights with seeds of its own (xy 100 s, z 60 s at three times the paper's
amplitude, yaw 60 s; set B, 0.15 s delay, light wind, mocap noise, stale frames). Per coefficient: the mean against the
truth (t of the mean, rejected beyond 3.34: a family-wise 1 % over 12 coefficients), the share of 95 % intervals that
hold the truth (a status other than `ok` is a miss), and the mean half-width over 1.96 times the Cramer-Rao bound at the
truth.
"""

import functools
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from rotorfit.card import load_card
from rotorfit.estimate import free_of
from rotorfit.excitation import two_sines
from rotorfit.fit import fit
from rotorfit.flight import Flight, flight_from_log
from rotorfit.frames import AXES, Array
from rotorfit.likelihood import Point, inverted, score
from rotorfit.model import COEFFICIENTS
from rotorfit.record import record
from rotorfit.simulator import Truth, as_log, simulate_flight

MANOEUVRES = ((("x", "y"), 1.0, 100.0), (("z",), 3.0, 60.0), (("yaw",), 1.0, 60.0))
REJECTED = 3.34
"""Two-sided 0.01 / 12 point of the normal distribution."""


def flights(seed: int) -> list[Flight]:
    card = load_card("rotorfit-demo")
    out = []
    for number, (axes, amplitude, duration) in enumerate(MANOEUVRES):
        inputs = functools.partial(two_sines, axes=axes, amplitude=amplitude)
        simulated = simulate_flight(Truth(), inputs, duration, len(MANOEUVRES) * seed + number)
        out.append(flight_from_log(as_log(simulated), card))
    return out


def truth_of(axis: str) -> Array:
    k, truth = AXES.index(axis), Truth()
    return np.array([truth.gamma[2 * k], truth.gamma[2 * k + 1], truth.delay[k]])


def bound(axis: str, flight: Flight) -> Array:
    """Cramer-Rao bound on the standard errors of input, damping and delay, the disturbance levels being known."""
    rec = record(flight, (axis,))
    assert rec is not None
    truth, k, (g, b, tau) = Truth(), AXES.index(axis), truth_of(axis)
    rate, parts = 1 / truth.wind_time[k], rec.starts.size
    levels = [2 * truth.wind_sigma[k] ** 2 * rate, truth.mocap_noise[k] ** 2, b + rate, 4 * b * rate / (b + rate) ** 2]
    point = Point(np.array([g]), np.log([b]), np.array([tau]), np.zeros((1, 1)), np.zeros((parts, 1)), np.log([levels]))
    information = score([rec], point).information[: point.n, : point.n]
    errors = np.sqrt(np.diag(inverted(information, free_of([rec], [True])[: point.n])))[:3]
    return errors * np.array([1.0, b, 1.0])


def one(seed: int) -> list[tuple[float, float, float, bool]]:
    """Estimate, half-width over 1.96 bounds, and whether the interval is a hit, per coefficient."""
    recorded = flights(seed)
    model = fit(recorded).model
    out = []
    for axis in AXES:
        flight = recorded[0 if axis in ("x", "y") else AXES.index(axis) - 1]
        for name, true, least in zip(COEFFICIENTS, truth_of(axis), bound(axis, flight), strict=True):
            known = model.axes[axis]
            low, high = known.ci95[name]
            hit = known.status[name] == "ok" and low is not None and high is not None and low <= true <= high
            value = getattr(known, name)
            width = np.nan if low is None or high is None else (high - low) / 2 / (1.96 * least)
            out.append((np.nan if value is None else value, true, width, hit))
    return out


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    with ProcessPoolExecutor() as pool:
        rows = np.array(list(pool.map(one, range(first, first + count), chunksize=5)), dtype=float)
    names = [f"{axis}.{name}" for axis in AXES for name in COEFFICIENTS]
    print(f"{count} repetitions, seeds from {first}")
    print(f"{'coefficient':14}{'truth':>9}{'mean':>9}{'t':>7}{'covered':>9}{'width':>7}{'missing':>9}")
    table = {}
    for i, name in enumerate(names):
        value, true, width, hit = rows[:, i].T
        known = np.isfinite(value)
        t = (value[known].mean() - true[0]) / (value[known].std(ddof=1) / np.sqrt(known.sum()))
        table[name] = {
            "truth": true[0],
            "mean": value[known].mean(),
            "t": t,
            "covered": hit.mean(),
            "width": np.nanmean(width),
            "missing": int((~known).sum()),
        }
        verdict = " rejected" if abs(t) > REJECTED else ""
        row = table[name]
        print(
            f"{name:14}{row['truth']:9.4f}{row['mean']:9.4f}{t:+7.2f}{row['covered']:9.3f}{row['width']:7.2f}"
            f"{row['missing']:9d}{verdict}"
        )
    pooled = rows[:, :, 3].mean()
    print(f"pooled coverage {100 * pooled:.2f} %, mean width {np.nanmean(rows[:, :, 2]):.3f}")
    result = {"repetitions": count, "first_seed": first, "pooled": pooled, "coefficients": table}
    Path(__file__).with_name("coverage.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
