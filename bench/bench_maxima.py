"""Does the fit find the highest maximum of each law? Its maxima against the best of many random starts.

    python bench/bench_maxima.py [--data FOLDER] [--only NAME ...] [--starts N] [--seed SEED] [-o FILE]

Every flight of `bench_real_coverage.py` is fitted alone. On each axis that is excited, each default law is climbed
again from N random starts: delay, damping, lag and zero from `RANGES`; gain, trims and start velocities solved for;
levels of the fit for half of them, the usual ones for the others. After a short climb with levels held, those that
ended together or far below the best are dropped, and the rest is climbed to the maximum. Another axis of the same
likelihood starts at its estimate.

A law is missed by the height of log-likelihood and log prior of the best of these maxima above the fit's. Only what the
fit would take counts: a maximum that predicts the flight 1 s ahead no worse, within 5 %, and is no inverse loop.

Printed per vehicle: the number of laws over all flights and axes; how many are missed by more than 1 and by more than
3; the median of all misses (0 where nothing is higher) and the largest; and of how many laws no random start came
within 1 of the best maximum known, which says how much the starts themselves can miss. Then every miss above 1: the
parameters of both maxima, the ratio of their 1 s prediction errors, and how many full climbs ended within 1 of the
higher one. No recording is part of the project; without them nothing is run.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench_real_coverage import VEHICLES, card_of
from rotorfit.app.workflows import load_flight
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import FIRST_ORDER_DELAY, LAG, start_levels
from rotorfit.estimation.fitting import estimate_group
from rotorfit.estimation.grouping import groups_of, serving_flights, without_held_axes
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.latency import align_velocity
from rotorfit.estimation.likelihood.law_average import default_laws, no_worse
from rotorfit.estimation.likelihood.law_search import projected
from rotorfit.estimation.likelihood.optima import ALIKE, is_inverse_loop, prediction_error
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.richer_laws import finished, posterior
from rotorfit.files.log_span import parse_log

RANGES = {"delay": (-0.05, 0.6), "damping": (0.05, 30.0), "lag": (0.01, 1.0), "zero": (0.0, 0.5)}
"""Of the random starts: delay [s], damping [1/s], lag [s] and zero [s]; damping and lag by their logarithms."""

SAME = np.array([0.02, 0.1, 0.1, 0.02])
"""Largest differences of short climbs that ended together: delay [s], logarithms of damping and lag, zero [s]."""

FAR_BELOW = 15.0
"""Fall of the objective below the best short climb from the same levels beyond which one is not continued."""

HIGHER, MUCH_HIGHER = 1.0, 3.0
"""Differences in log-likelihood and log prior that are counted."""


@dataclass(frozen=True)
class Compared:
    """A law of one axis of one flight.

    Attributes:
        vehicle: Name.
        flight: Label of the log.
        axis: Name.
        law: Name.
        missed: Height of the best other maximum above the fit's, 0 if none is higher.
        found: Coefficients of the fit's maximum.
        best: Those of the higher one.
        prediction: Its 1 s prediction error over that of the fit's.
        reached: How many climbs ended within `HIGHER` of it.
        climbs: Of how many.
    """

    vehicle: str
    flight: str
    axis: str
    law: str
    missed: float
    found: dict[str, float]
    best: dict[str, float]
    prediction: float
    reached: int
    climbs: int


def fitted_laws(flight: Flight) -> Iterator[tuple[str, Sequence[Flight], Estimate]]:
    """Axis, serving flights and estimate of every default law that the fit climbs, also of those it then leaves out."""
    flights = [align_velocity(one, AXES) for one in without_held_axes([flight])]
    for group in groups_of(flights, AXES):
        serving, estimates = serving_flights(flights, group), estimate_group(flights, group, {})
        for axis, (plain, *richer) in default_laws(serving, estimates, {}).items():
            if plain.excited:
                yield from ((axis, serving, one) for one in (no_worse(plain, richer), *richer))


def random_start(estimate: Estimate, rng: np.random.Generator, levels: bool) -> Point:
    """A start with random coefficients on the estimate's axis; with its levels, or with the usual ones."""
    point, k = estimate.optimum.point, estimate.place
    drawn = {name: rng.uniform(*np.log(RANGES[name])) for name in ("damping", "lag")}
    drawn |= {name: rng.uniform(*RANGES[name]) for name in ("delay", "zero")}
    log_damping, delay, extra, gain = (
        part.copy() for part in (point.log_damping, point.delay, point.extra, point.gain)
    )
    gain[k] *= np.exp(drawn["damping"] - log_damping[k])
    log_damping[k], delay[k] = drawn["damping"], drawn["delay"]
    for e, one in enumerate(point.structures[k].extras if point.structures else ()):
        extra[e, k] = drawn["lag"] if one.place == LAG else drawn["zero"]
    held = point.levels if levels else np.tile(start_levels(point.measured), (gain.size, 1))
    start = replace(point, gain=gain, log_damping=log_damping, delay=delay, extra=extra, levels=held)
    return start.with_flat(np.clip(start.flat(), *start.bounds()))


def begun(estimate: Estimate, start: Point) -> tuple[float, Point]:
    """Objective and end of a short climb with levels held, gain and trims solved for first."""
    prior, free = estimate.optimum.prior, estimate.optimum.free.copy()
    start = projected(estimate.records, [start], estimate.place, prior)[0][1]
    free[start.n :] = False
    top = maximise(estimate.records, start, free, tolerance=0.3, most=25, prior=prior)
    return top.score.objective, top.point


def other_maxima(estimate: Estimate, starts: int, seed: int) -> list[Optimum]:
    """Maxima from random starts."""
    rng, k = np.random.default_rng(seed), estimate.place
    moving = [bool(free) for free in estimate.optimum.free[: estimate.optimum.point.gain.size]]
    ends: list[Point] = []
    for own in (True, False):
        short = [begun(estimate, random_start(estimate, rng, own)) for _ in range(starts // 2)]
        highest, kept = max(value for value, _ in short), []
        for value, point in short:
            place = np.array(
                [point.delay[k], point.log_damping[k], *(point.extra[e, k] for e in range(len(point.extra_values(k))))]
            )
            near = [np.abs(place - other) < SAME[: place.size] for other in kept]
            if value > highest - FAR_BELOW and not any(one.all() for one in near):
                kept.append(place)
                ends.append(point)
    prior = estimate.optimum.prior
    return [finished(estimate.records, point, moving, prior) for point in ends]


def coefficients_of(optimum: Optimum, k: int) -> dict[str, float]:
    """Coefficients and levels of an axis, rounded for reading."""
    point = optimum.point
    values = {"input": point.gain[k], "damping": np.exp(point.log_damping[k]), "delay": point.delay[k]}
    values |= point.extra_values(k) | dict(zip(("q", "r", "alpha", "kappa"), np.exp(point.levels[k]), strict=False))
    return {name: float(f"{value:.3g}") for name, value in values.items()}


def compared(serving: Sequence[Flight], estimate: Estimate, starts: int, seed: int) -> dict[str, Any]:
    """The fit's maximum of a law and the best other one that it would have taken: fields of `Compared`."""
    found, k = estimate.optimum, estimate.place
    axes, here = estimate.records[0].axes, posterior(found)
    error = prediction_error(serving, axes, found)[0][k]
    tops = other_maxima(estimate, starts, seed)
    best, ratio = found, 1.0
    for top in sorted(tops, key=posterior, reverse=True):
        share = float(prediction_error(serving, axes, top)[0][k] / error)
        if posterior(top) <= here or (not is_inverse_loop(top, k) and not share > 1 + ALIKE):
            best, ratio = (top, share) if posterior(top) > here else (found, 1.0)
            break
    reached = sum(abs(posterior(top) - posterior(best)) < HIGHER for top in tops)
    return {
        "law": (found.point.structures[k] if found.point.structures else FIRST_ORDER_DELAY).name,
        "missed": posterior(best) - here,
        "found": coefficients_of(found, k),
        "best": coefficients_of(best, k),
        "prediction": ratio,
        "reached": reached,
        "climbs": len(tops),
    }


def print_table(rows: Sequence[Compared]) -> None:
    """One line per vehicle, then all, then the misses."""
    print(f"{'vehicle':28}{'laws':>6}{'> 1':>6}{'> 3':>6}{'median':>9}{'largest':>9}{'not reached':>13}")
    for name in (*dict.fromkeys(row.vehicle for row in rows), "all"):
        known = [row for row in rows if name in (row.vehicle, "all")]
        missed = np.array([row.missed for row in known])
        print(
            f"{name:28}{missed.size:6}{np.sum(missed > HIGHER):6}{np.sum(missed > MUCH_HIGHER):6}"
            f"{np.median(missed):9.2f}{missed.max():9.1f}{sum(not row.reached for row in known):13}"
        )
    for row in sorted(rows, key=lambda row: -row.missed):
        if row.missed > HIGHER:
            print(
                f"{row.missed:7.1f}  {row.flight} {row.axis} {row.law}; prediction {row.prediction:.3f}, "
                f"{row.reached} of {row.climbs}\n         found {row.found}\n         best  {row.best}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--only", nargs="*", default=[""], help="beginnings of names of vehicles")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", dest="output", type=Path)
    options = parser.parse_args()
    if not options.data.is_dir():
        raise SystemExit(f"{options.data}: no recordings there; name their folder with --data")
    begin, rows = time.process_time(), []
    for vehicle in VEHICLES:
        if not vehicle.name.startswith(tuple(options.only)):
            continue
        for log in vehicle.logs:
            where = parse_log(str(options.data / log))
            flight = load_flight(where, card_of(where.path))
            for axis, serving, estimate in fitted_laws(flight):
                known = compared(serving, estimate, options.starts, options.seed)
                rows.append(Compared(vehicle.name, log, axis, **known))
            if options.output:
                options.output.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    print_table(rows)
    print(f"{time.process_time() - begin:.0f} s of a processor")


if __name__ == "__main__":
    main()
