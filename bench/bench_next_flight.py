"""Does the interval of the next flight hold, given two or three recorded flights of a vehicle?

    python bench/bench_next_flight.py --cache FOLDER [--data FOLDER] [--structure LAW] [--whole]

Every flight, or part of one, of `bench_real_coverage.py` is fitted alone (whose cache this reads). Of every two, and
every three, of a vehicle the next flight is predicted by `random_effects`, as a fit of several flights does it: from
their values, their errors (this flight) and the mean variance that the tests of the law added. Every other flight
of the vehicle is then compared with that, allowing for its own error times its own D:

    z = 1.96 |mean - y| / sqrt(h^2 + (1.96 s D)^2),     h the half width of the interval of the next flight

Shares with z below 1.96 are listed by the p-value of Cochran's Q, by which the given flights agree or not; beside them
the same by Hartung and Knapp's interval without a prior where p < 0.05, and how much wider that is (median). With
`--whole`, all flights but one of a vehicle of four or more are fitted together instead, tests of the law included, and
the interval of the next flight is compared with the one left out. Below,
without recordings, the calculation alone: 800 vehicles a row (seed 1) whose flights differ by a given spread, in
standard errors of one flight.
"""

import argparse
import itertools
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from bench_real_coverage import VEHICLES, card_of, fitted, known_of
from bench_spread_scales import half_of
from rotorfit.app.workflows import load_flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import NORMAL, Model
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.judgement.random_effects import random_effects
from rotorfit.estimation.judgement.spread_prior import spread_scale
from rotorfit.files.log_span import parse_log

P_VALUES = ((0.0, 1.0), (0.05, 1.0), (0.001, 0.05), (0.0, 0.001))


@dataclass(frozen=True)
class Told:
    """What one flight says of a quantity: value, standard error (this flight), and D."""

    value: float
    error: float
    doubt: float


@dataclass(frozen=True)
class Next:
    """One comparison: Cochran's p-value, z, z by Hartung and Knapp, and the half width of theirs over ours."""

    p_value: float
    z: float
    without_prior: float
    wider: float


def quantities(data: Path, structure: str, cache: Path) -> Iterator[tuple[str, list[Told]]]:
    """Name of every quantity of an axis of a vehicle, and what each of its flights says of it."""
    for vehicle in VEHICLES:
        models = [fitted(data, log, structure, cache) for log in vehicle.logs]
        groups = defaultdict(list)
        for log, model in zip(vehicle.logs, models, strict=True):
            groups[log.split("@")[0] if vehicle.within else ""].append(model)
        for group, axis in itertools.product(groups.values(), AXES):
            both = [(known_of(model, axis, False), known_of(model, axis, True)) for model in group]
            for name in sorted(set().union(*(one.keys() & own.keys() for one, own in both))):
                yield (
                    name,
                    [
                        Told(
                            own[name].value,
                            (own[name].high - own[name].low) / (2 * NORMAL),
                            max(half_of(one[name], own[name], name, side).doubt for side in (-1, 1)),
                        )
                        for one, own in both
                        if name in one and name in own
                    ],
                )


def compared(name: str, given: Sequence[Told], others: Sequence[Told]) -> Iterator[Next]:
    """The other flights of a vehicle beside what is predicted from the given ones."""
    y, s = (np.array([getattr(one, what) for one in given]) for what in ("value", "error"))
    together = float(np.sum(s**-2.0) ** -0.5)
    law = math.sqrt(float(np.mean([(one.doubt**2 - 1) * one.error**2 for one in given])))
    found = random_effects(y, s, spread_scale(name) * together * math.sqrt(len(y)), law)
    half = NORMAL * math.hypot(found.next_sd, law)
    wide = max(half, hartung_knapp(y, s, found.reml)) if found.p_value < 0.05 else half
    for other in others:
        off, own = NORMAL * abs(found.mean - other.value), NORMAL * other.error * other.doubt
        yield Next(found.p_value, off / math.hypot(half, own), off / math.hypot(wide, own), wide / half)


def hartung_knapp(y: np.ndarray, s: np.ndarray, spread: float) -> float:
    """Half width of the interval of the next flight without a prior.

    Source: J. Hartung, G. Knapp, Statistics in Medicine 20 (2001), pp. 3875-3889, with a factor of at least 1.
    """
    weight = 1 / (s**2 + spread**2)
    mean = float(weight @ y / weight.sum())
    factor = max(float(weight @ (y - mean) ** 2) / (y.size - 1), 1.0)
    return float(student.ppf(0.975, y.size - 1)) * math.sqrt(factor / float(weight.sum()) + spread**2)


def recorded(data: Path, structure: str, cache: Path) -> None:
    """Prints the shares of recorded flights."""
    every = list(quantities(data, structure, cache))
    for count in (2, 3):
        found = [
            one
            for name, told in every
            for given in itertools.combinations(told, count)
            for one in compared(name, given, [other for other in told if other not in given])
        ]
        for low, high in P_VALUES:
            some = [one for one in found if low <= one.p_value <= high]
            z, wide = (np.array([getattr(one, what) for one in some]) for what in ("z", "without_prior"))
            with_prior, without = (
                f"{100 * np.mean(each < NORMAL):.1f} % inside, root mean square {np.sqrt(np.mean(each**2)):.2f}"
                for each in (z, wide)
            )
            wider = float(np.median([one.wider for one in some]))
            print(f"after {count} flights, p {low:g} to {high:g}: {z.size:5} next, {with_prior}")
            print(f"{'without the prior':>40}, {wider:.1f} times as wide: {without}")


def left_out(data: Path, structure: str, cache: Path) -> None:
    """Prints the shares of flights that were left out of a fit of the others."""
    for vehicle in (one for one in VEHICLES if len(one.logs) >= 4 and not one.within and "@" not in one.logs[0]):
        flights = [load_flight(parse_log(str(data / log)), card_of(str(data / log))) for log in vehicle.logs]
        alone = [fitted(data, log, structure, cache) for log in vehicle.logs]
        found = []
        for i, other in enumerate(alone):
            others = [flight for j, flight in enumerate(flights) if j != i]
            model = fit(others, structure=structure).model
            found += [z for axis in AXES for z in _beside(model, other, axis)]
        z = np.array(found)
        inside, factor = 100 * np.mean(z < NORMAL), np.sqrt(np.mean(z**2))
        print(f"{vehicle.name}: {z.size} left out, {inside:.1f} % inside, root mean square {factor:.2f}", flush=True)


def _beside(model: Model, other: Model, axis: str) -> Iterator[float]:
    """z of each quantity of a flight beside the interval of the next flight, by the half width that faces it."""
    mean, wide, own = known_of(model, axis, False), known_of(other, axis, False), known_of(other, axis, True)
    for name, spread in model.axes[axis].spread.items():
        low, high = spread.next_flight
        if name not in mean.keys() & wide.keys() & own.keys() or low is None or high is None:
            continue
        if spread.logarithmic and low * high <= 0:
            continue
        ends = sorted(np.log(np.abs([low, high]))) if spread.logarithmic else [low, high]
        off = wide[name].value - mean[name].value
        half = ends[1] - mean[name].value if off > 0 else mean[name].value - ends[0]
        doubt = max(half_of(wide[name], own[name], name, side).doubt for side in (-1, 1))
        yield NORMAL * abs(off) / math.hypot(half, doubt * (own[name].high - own[name].low) / 2)


def simulated() -> None:
    """Prints the shares of the calculation alone."""
    rng = np.random.default_rng(1)
    for scale, count, spread in itertools.product((0.3, 0.7), (2, 3, 6), (0.0, 1.0, 3.0, 10.0)):
        held = np.zeros(2)
        for _ in range(800):
            d = spread * rng.standard_normal(count + 1)
            found = random_effects(d[:count] + rng.standard_normal(count), np.ones(count), scale)
            held += abs(found.mean) < NORMAL * found.sd, abs(found.mean - d[count]) < NORMAL * found.next_sd
        vehicle, following = 100 * held / 800
        row = f"scale {scale}, {count} flights, spread {spread:4.0f}"
        print(f"{row}: {vehicle:.0f} % hold the vehicle, {following:.0f} % the next")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--whole", action="store_true", help="fit all flights but one together")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    if options.data.is_dir():
        (left_out if options.whole else recorded)(options.data, options.structure, options.cache)
    else:
        print(f"{options.data}: no recordings there; name their folder with --data")
    if not options.whole:
        simulated()


if __name__ == "__main__":
    main()
