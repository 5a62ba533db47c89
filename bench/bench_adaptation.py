"""Does prediction adapt to the wind of the predicted flight, and do its error bands have their nominal coverage?

    python bench/bench_adaptation.py [PATTERN]

Models fitted to one flight predict another one: simulated vehicles in calm and in gusty air (from either to either,
three vehicles, three kinds of wind), and recorded flights where available. Three filters run on the same starts with
the same coefficients: `adapted`, as `validate` predicts; `fixed`, with the levels of the training flight; `true`, with
those of the flight's own wind, which is known in simulation only. Reported are ratios of velocity RMSE, as geometric
mean over axes and flights and as the worst one, and the coverage of the 50 and 95 % bands over all starts.
PATTERN selects sets by a part of their name; without it the result is written to adaptation.json beside this file.
"""

import os
import sys

for thread in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(thread, "1")  # read when numpy is first imported, below

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from peers.flights import REAL_FLIGHTS, dynamics_of, random_steps, real_cases, recorded
from rotorfit.app.workflows import load_flights
from rotorfit.assessment.validation import dynamics_from_model
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.dynamics.error_bands import NOMINAL, Bands, error_bands
from rotorfit.dynamics.protocol import AxisDynamics, horizon_errors, predict_flight
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.grouping import without_held_axes
from rotorfit.files.cards import load_card
from rotorfit.files.log_span import parse_log
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import GAMMA_A, GAMMA_B, GAMMA_E, Controller, Truth, as_log, simulate_flight

HORIZONS = (0.5, 1.0, 2.0, 5.0)
WINDS = {"1 s": (0.02, 0.15, 1.0), "4 s": (0.02, 0.2, 4.0), "room": (0.01, 0.5, 1.0)}
"""Calm and gusty standard deviation of the wind [m/s^2], and its memory [s]."""

AMPLITUDE = (0.3, 0.3, 0.3, 0.2)
SITL = (("s01", "s06"), ("s06", "s01"), ("s01", "s02"))
HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Pair:
    """Training flights, a flight to predict, and its vehicle and wind where they are known; sets are put together."""

    group: str
    training: Sequence[Flight]
    test: Flight
    truth: Mapping[str, AxisDynamics] = field(default_factory=dict)


def simulated_pairs() -> Iterator[Pair]:
    """Every vehicle and wind: from calm and gusty to calm and gusty."""
    card = load_card("rotorfit-demo")
    for v, gamma in enumerate((GAMMA_B, GAMMA_A, GAMMA_E)):
        for w, (calm, gusty, memory) in enumerate(WINDS.values()):
            base = replace(Truth(), gamma=gamma, delay=(0.2, 0.2, 0.12, 0.1), wind_time=(memory,) * 4)
            air = {
                "calm": replace(base, wind_sigma=(calm, calm, calm, 0.3 * calm)),
                "gusty": replace(base, wind_sigma=(gusty, 0.7 * gusty, 0.6 * gusty, 0.2 * gusty)),
            }
            flights = {
                (name, other): flight_from_log(
                    as_log(simulate_flight(truth, partial(random_steps, seed=seed, amplitude=AMPLITUDE), 60.0, seed,
                                           controller=Controller())), card)
                for k, (name, truth) in enumerate(air.items())
                for other in (0, 1)
                for seed in (900 + 40 * v + 10 * w + 2 * k + other,)
            }  # fmt: skip
            for one in air:
                for to in air:
                    test = flights[to, int(one == to)]
                    yield Pair(f"simulated, {one} to {to}", [flights[one, 0]], test, dynamics_of(air[to]))


def recorded_pairs() -> Iterator[Pair]:
    """The sets of the peers, every hexarotor flight to every other, and flights of a simulated autopilot."""
    if not REAL_FLIGHTS.is_dir():
        return
    for case in real_cases():
        if "hexarotor" not in case.name:
            training, tests = case.make()
            for test in tests:
                yield Pair(case.name.split(",")[0].split()[0], training, test)
    dji, _ = recorded([(f"dji-hexarotor/Datos_Prueba{i}.mat", (None, None)) for i in range(1, 7)], [])()
    for i, one in enumerate(dji):
        for other in dji[:i] + dji[i + 1 :]:
            yield Pair("dji-hexarotor", [one], other)
    for names in SITL:
        logs = [parse_log(str(REAL_FLIGHTS / "arducopter-sitl" / f"{name}.mcap")) for name in names]
        flown, next_flown = (load_flights([log])[0] for log in logs)
        yield Pair("arducopter-sitl", [flown], next_flown)


def predicted(flight: Flight, dynamics: Mapping[str, AxisDynamics], *, adapt: bool) -> tuple[Array, list[Bands]]:
    """Velocity RMSE, shape (H, 4), and the bands of every horizon."""
    parts = predict_flight(flight, dynamics, max(HORIZONS), adapt=adapt)
    errors = [horizon_errors(parts, [part.predicted for part in parts], h) for h in HORIZONS]
    rmse = np.array([[np.nan if (e := error[axis].velocity_rmse) is None else e for axis in AXES] for error in errors])
    return rmse, [error_bands(parts, h) for h in HORIZONS]


def scored(pair: Pair, training: Mapping[str, AxisDynamics]) -> tuple[dict[str, Array], list[Array]]:
    """Ratios of the axes that count, each (A, H), and what the bands held, a (n, 2 quantities, 2 shares) a horizon."""
    counted = [k for k, a in enumerate(AXES) if a in pair.test.axes and training.get(a) and training[a].input
               and np.any(pair.test.command[:, k])]  # fmt: skip
    adapted, bands = predicted(pair.test, training, adapt=True)
    ratios = {"fixed": adapted / predicted(pair.test, training, adapt=False)[0]}
    if pair.truth:
        known = {axis: replace(own, levels=pair.truth[axis].levels) for axis, own in training.items()}
        ratios["true"] = adapted / predicted(pair.test, known, adapt=False)[0]
    held = []
    for band in bands:
        inside = np.stack([(np.abs(band.error) <= band.half_width(n)).astype(float) for n in NOMINAL], axis=-1)
        good = np.asarray(np.isfinite(band.error).all(axis=1))
        held.append(np.concatenate([inside[good[:, k], ::-1, k] for k in counted] or [np.empty((0, 2, 2))]))
    return {name: ratio[:, counted].T for name, ratio in ratios.items()}, held


def run(pairs: Sequence[Pair]) -> dict[str, Any]:
    """Of one group."""
    ratios: dict[str, list[Array]] = {}
    held: list[list[Array]] = [[] for _ in HORIZONS]
    known: dict[int, Mapping[str, AxisDynamics]] = {}
    for pair in pairs:
        for test in without_held_axes([pair.test]):
            key = id(pair.training[0])
            if key not in known:
                known[key] = dynamics_from_model(fit(pair.training).model)
            found, inside = scored(replace(pair, test=test), known[key])
            for name, values in found.items():
                ratios.setdefault(name, []).append(values)
            for h, each in enumerate(inside):
                held[h].append(each)
    out: dict[str, Any] = {"group": pairs[0].group}
    for name, found_ratios in ratios.items():
        logs = np.log(np.concatenate(found_ratios))
        out[f"adapted_over_{name}"] = {
            "mean": np.exp(np.nanmean(logs, axis=0)).round(3).tolist(), "axes": len(logs),
            "worst": np.exp(np.nanmax(logs, axis=0)).round(3).tolist(),
        }  # fmt: skip
    for number, what in enumerate(("velocity", "position")):
        shares = [np.concatenate(each)[:, number].mean(axis=0) for each in held]
        out[f"{what}_bands"] = {f"{n:g}": [round(float(s[i]), 3) for s in shares] for i, n in enumerate(NOMINAL)}
    return out


def main() -> None:
    pattern = sys.argv[1] if len(sys.argv) > 1 else ""
    groups: dict[str, list[Pair]] = {}
    for pair in [*simulated_pairs(), *recorded_pairs()]:
        if pattern in pair.group:
            groups.setdefault(pair.group, []).append(pair)
    results = []
    for pairs in groups.values():
        results.append(run(pairs))
        print(json.dumps(results[-1]), flush=True)
    if not pattern:
        text = json.dumps({"horizons": HORIZONS, "groups": results}, indent=1, allow_nan=False)
        (HERE / "adaptation.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
