"""Do intervals hold for the next flight? Pairs of recorded flights of one vehicle, and of parts of a flight.

    python bench/bench_real_coverage.py [--data FOLDER] [--structure LAW] [--cache FOLDER] [-o FILE]

Every flight, or part, is fitted alone. Two of one vehicle are a pair; their intervals agree about a coefficient if the
difference is no larger than the two half widths that face each other, added in quadrature. With half widths of 1.96
standard errors of "the vehicle", 95 of 100 pairs agree and the root mean square of

    z = 1.96 (a - b) / sqrt(h_a^2 + h_b^2)

is 1. Input, damping, steady gain and lag are compared by their logarithms, delay and total lag by their values. A pair
counts where both intervals are closed. Intervals of "this flight" are shown in addition to those of "the vehicle": the
difference is the spread between flights. No recording is part of the project; without them nothing is run.
"""

import argparse
import hashlib
import itertools
import json
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binom

from rotorfit.app.workflows import load_flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.log_span import parse_log
from rotorfit.files.models import load, save

NORMAL = 1.959964
"""97.5 % point of the normal distribution."""

LOGARITHMIC = ("input", "damping", "steady_gain", "lag")
"""What is compared by its logarithm."""

LEAST_POOL = 6
"""Flights or parts from which on a coefficient's factor is judged."""


@dataclass(frozen=True)
class Vehicle:
    """Logs whose flights are compared.

    Attributes:
        name: Of the folder, and what of it.
        logs: Relative to the folder of the recordings, each with a span where it is part of a log.
        within: Whether only parts of the same log are compared.
    """

    name: str
    logs: tuple[str, ...]
    within: bool = False


def _parts(log: str, duration: float, count: int) -> tuple[str, ...]:
    edges = np.linspace(0.0, duration, count + 1)
    return tuple(f"{log}@{low:g}:{high:g}" for low, high in itertools.pairwise(edges))


DJI = tuple(f"dji-hexarotor/Datos_Prueba{i}.mat" for i in range(1, 7))
SITL = tuple(f"arducopter-sitl/s{i:02d}.mcap" for i in range(1, 7))
ARDRONE = "ardrone2-optitrack/{}_LARANJA_COMPLETO{}.mat"
VEHICLES = (
    Vehicle("bebop2-wsu X, thirds", _parts("bebop2-wsu/Training_CT_TestDay_X.mat", 168.0, 3)),
    Vehicle("bebop2-wsu Z, thirds", _parts("bebop2-wsu/Training_CT_TestDay_Z.mat", 136.0, 3)),
    Vehicle("bebop2-optitrack pitch", tuple(f"bebop2-optitrack/monster_pitch_{part}.bag" for part in ("trn", "tst"))),
    Vehicle("bebop2-optitrack vert", tuple(f"bebop2-optitrack/monster_vert_{part}.bag" for part in ("trn", "tst"))),
    Vehicle(
        "ardrone2-optitrack",
        (
            ARDRONE.format("PSIDOT_02_Feb_2022_10_55_15", ""),
            ARDRONE.format("PSIDOT_02_Feb_2022_11_03_43", ""),
            ARDRONE.format("ZDOT_02_Feb_2022_10_39_58", ""),
            ARDRONE.format("ZDOT_02_Feb_2022_10_43_56", "_bonito"),
        ),
    ),
    Vehicle("dji-hexarotor", DJI),
    Vehicle("dji-hexarotor, halves", tuple(part for log in DJI for part in _parts(log, 50.0, 2)), within=True),
    Vehicle("arducopter-sitl", SITL),
    Vehicle("arducopter-sitl, halves", tuple(part for log in SITL for part in _parts(log, 60.0, 2)), within=True),
    Vehicle("bebop2-joystick, halves", _parts("bebop2-joystick/record_velocity.csv", 70.0, 2)),
    Vehicle("px4-s500, halves", _parts("px4-s500/TestFlight1.ulg", 54.0, 2)),
    Vehicle("arducopter, quarters", _parts("arducopter/2014-10-18_20-04-24.bin", 318.0, 4)),
    Vehicle("tello, halves", _parts("tello/demo_spotlight.txt", 150.0, 2)),
)


@dataclass(frozen=True)
class Known:
    """A coefficient as one flight gives it, by the scale that it is compared on.

    Attributes:
        value: Between the ends.
        low: End of the interval.
        high: The other.
        ok: Whether it is published.
    """

    value: float
    low: float
    high: float
    ok: bool


@dataclass(frozen=True)
class Pair:
    """Two flights of one vehicle about one coefficient.

    Attributes:
        vehicle: Name.
        axis: Name.
        name: Of the coefficient or combination.
        flights: Both labels.
        z: Difference in standard errors of it.
        ok: Whether both flights publish it.
    """

    vehicle: str
    axis: str
    name: str
    flights: tuple[str, str]
    z: float
    ok: bool


def fitted(data: Path, log: str, structure: str, cache: Path | None) -> Model:
    """The model of one flight; kept in the cache, by flight, law and the package's own source."""
    kept = None if cache is None else cache / f"{_key(log, structure)}.json"
    if kept is not None and kept.exists():
        return load(kept)
    where = parse_log(str(data / log))
    model = fit([load_flight(where, card_of(where.path))], structure=structure).model
    if kept is not None:
        save(model, kept)
    return model


def card_of(path: str) -> str | None:
    """The card beside a recording; None where the recording carries its own, or a built-in one fits."""
    card = Path(path).parent / "card.toml"
    return None if path.endswith(".mcap") or not card.exists() else str(card)


def _key(log: str, structure: str) -> str:
    source = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].glob("src/rotorfit/**/*.py")):
        source.update(path.read_bytes())
    return hashlib.sha256(f"{log} {structure} {source.hexdigest()}".encode()).hexdigest()[:24]


def known_of(model: Model, axis: str, of_flight: bool) -> dict[str, Known]:
    """Coefficients, further parameters and combinations of an axis with closed intervals."""
    one = model.axes[axis]
    if one.predictor is None:
        return {}
    values = {name: getattr(one.predictor, name) for name in ("input", "damping", "delay")} | dict(one.predictor.extra)
    ends = {**one.ci95, **one.ci95_flight} if of_flight else dict(one.ci95)
    for name, part in one.combinations.items():
        values[name], ends[name] = part.value, (part.ci95_flight if of_flight else None) or part.ci95
    out = {}
    for name, value in values.items():
        low, high = ends.get(name, (None, None))
        if low is None or high is None or not low < value < high:
            continue
        if name in LOGARITHMIC:
            if low * high <= 0:
                continue
            value, low, high = np.log(abs(value)), *sorted(np.log(np.abs([low, high])))
        out[name] = Known(float(value), float(low), float(high), one.status.get(name, "ok") == "ok")
    return out


def pair_of(one: Known, other: Known) -> float:
    """z of two flights, by the half widths that face each other."""
    below, above = (one, other) if one.value < other.value else (other, one)
    return NORMAL * (above.value - below.value) / float(np.hypot(below.high - below.value, above.value - above.low))


def pairs_of(vehicle: Vehicle, models: Sequence[Model], of_flight: bool) -> Iterator[Pair]:
    """Every pair of flights of a vehicle that both know a coefficient."""
    for i, j in itertools.combinations(range(len(models)), 2):
        if vehicle.within and vehicle.logs[i].split("@")[0] != vehicle.logs[j].split("@")[0]:
            continue
        for axis in AXES:
            one, other = (known_of(models[place], axis, of_flight) for place in (i, j))
            for name in one.keys() & other.keys():
                ok = one[name].ok and other[name].ok
                labels = (vehicle.logs[i], vehicle.logs[j])
                yield Pair(vehicle.name, axis, name, labels, pair_of(one[name], other[name]), ok)


def row_of(pairs: Sequence[Pair]) -> dict[str, float]:
    """Number, share inside and factor of some pairs."""
    z = np.array([pair.z for pair in pairs])
    return {"n": z.size, "inside": float(np.mean(z <= NORMAL)), "factor": float(np.sqrt(np.mean(z**2)))}


def table_of(pairs: Sequence[Pair]) -> dict[str, dict[str, float]]:
    """Figures per vehicle, axis and coefficient; per coefficient over all; and of all."""
    groups: dict[str, list[Pair]] = defaultdict(list)
    for pair in pairs:
        groups[f"{pair.vehicle} | {pair.axis} | {pair.name}"].append(pair)
        groups[f"{pair.vehicle} | all | all"].append(pair)
        groups[f"all | {pair.axis} | {pair.name}"].append(pair)
        groups[f"all | all | {pair.name}"].append(pair)
        groups["all | all | all"].append(pair)
    return {key: row_of(group) for key, group in groups.items()}


def print_tables(tables: dict[str, dict[str, dict[str, float]]]) -> None:
    """Both kinds of interval side by side."""
    print(f"{'vehicle | axis | coefficient':52}{'pairs':>6}" + "".join(f"{kind:>18}" for kind in tables))
    for key in sorted(next(iter(tables.values()))):
        rows = [table[key] for table in tables.values() if key in table]
        cells = "".join(f"{100 * row['inside']:11.0f} %{row['factor']:5.2f}" for row in rows)
        print(f"{key:52}{rows[0]['n']:6.0f}{cells}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--cache", type=Path)
    parser.add_argument("-o", dest="output", type=Path, default=Path(__file__).with_name("real_coverage.json"))
    options = parser.parse_args()
    if options.cache:
        options.cache.mkdir(parents=True, exist_ok=True)
    if not options.data.is_dir():
        raise SystemExit(f"{options.data}: no recordings there; name their folder with --data")
    start = time.perf_counter()
    found: dict[str, list[Pair]] = defaultdict(list)
    for vehicle in VEHICLES:
        models = [fitted(options.data, log, options.structure, options.cache) for log in vehicle.logs]
        for kind in ("this flight", "the vehicle"):
            found[kind] += pairs_of(vehicle, models, kind == "this flight")
    tables = {kind: table_of(pairs) for kind, pairs in found.items()}
    print_tables(tables)
    pooled = tables["the vehicle"]["all | all | all"]
    chance = binom.interval(0.95, pooled["n"], 0.95)
    print(f"{pooled['n']:.0f} pairs; of independent ones {chance[0]:.0f} to {chance[1]:.0f} would be inside")
    print(f"{time.perf_counter() - start:.0f} s")
    worst = sorted((pair for pair in found["the vehicle"] if pair.z > NORMAL), key=lambda pair: -pair.z)[:20]
    options.output.write_text(
        json.dumps({"tables": tables, "worst": [vars(pair) for pair in worst]}, indent=1, allow_nan=False) + "\n"
    )


if __name__ == "__main__":
    main()
