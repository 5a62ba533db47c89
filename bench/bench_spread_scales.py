"""Scales of the prior on the spread between flights of a vehicle: estimated from recorded flights, tested on others.

    python bench/bench_spread_scales.py --cache FOLDER [--data FOLDER] [--structure LAW]

Of every pair of flights of one vehicle (`bench_real_coverage.py`, whose cache it reads) the difference d of a
coefficient is taken as normal, with variance

    s_a^2 (D_a^2 + t^2) + s_b^2 (D_b^2 + t^2),    t ~ half t_3 of scale k,

where s is the standard error of "this flight" and D the factor from the tests of the law. k maximises the likelihood of
all pairs, averaged over t, on a grid; each flight has the same total weight, however many pairs it is in. Nothing is
chosen by how many pairs agree. Then every vehicle is left out in turn, with all its sets, its pairs are judged by the
scales from the others, and the share inside and the factor are reported as in `bench_real_coverage.py`.
"""

import argparse
import itertools
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from bench_real_coverage import VEHICLES, Known, Vehicle, fitted, known_of, row_of
from bench_real_coverage import Pair as Judged
from rotorfit.core.frames import AXES
from rotorfit.core.model import NORMAL, Model
from rotorfit.estimation.judgement.random_effects import GRID, mixed_half_width, posterior
from rotorfit.estimation.judgement.spread_prior import spread_scale

SCALES = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0)
"""Candidates. 0.3 widens an interval by 10 %; a narrower prior would keep several flights from telling that they differ
by many errors."""

LEAST_PAIRS = 20
"""Pairs below which a coefficient gets no scale of its own."""

SHARE = posterior(np.zeros(GRID.size))
"""Of the values of the spread before any flight."""


@dataclass(frozen=True)
class Half:
    """One flight's side of a pair: its error (this flight), that of the vehicle, and D, on the scale of comparison."""

    error: float
    doubt: float


@dataclass(frozen=True)
class Pair:
    """Two flights of one vehicle about one coefficient; the weight makes each flight count once."""

    vehicle: str
    axis: str
    name: str
    difference: float
    below: Half
    above: Half
    weight: float


@cache
def widening(scale: float) -> float:
    """Half width of one flight's interval over that of its own error, where nothing doubts the law."""
    return mixed_half_width(1 + (scale * GRID) ** 2, SHARE) / NORMAL


def half_of(vehicle: Known, flight: Known, name: str, side: int) -> Half:
    """One side of an interval: what the law's tests added is what the prior in force does not explain."""
    wide, own = ((k.value - k.low) if side < 0 else (k.high - k.value) for k in (vehicle, flight))
    doubt = math.sqrt(max((wide / own) ** 2 - widening(spread_scale(name)) ** 2 + 1, 1.0))
    return Half(own / NORMAL, doubt)


def vehicle_name(vehicle: Vehicle) -> str:
    """Of all sets of one vehicle."""
    name = vehicle.name.split(",")[0].split()[0]
    return "bebop2-optitrack" if name.startswith("bebop2-optitrack") else name


def pairs_of(vehicle: Vehicle, models: Sequence[Model]) -> list[Pair]:
    """Every pair of flights of a vehicle that both know a coefficient."""
    out = []
    for axis in AXES:
        said = [(known_of(model, axis, False), known_of(model, axis, True)) for model in models]
        for i, j in itertools.combinations(range(len(models)), 2):
            if vehicle.within and vehicle.logs[i].split("@")[0] != vehicle.logs[j].split("@")[0]:
                continue
            (a, a_own), (b, b_own) = said[i], said[j]
            for name in a.keys() & b.keys() & a_own.keys() & b_own.keys():
                first = a[name].value < b[name].value
                (low, low_own), (high, high_own) = ((a, a_own), (b, b_own)) if first else ((b, b_own), (a, a_own))
                telling = sum(name in one for one, _ in said)
                out.append(Pair(
                    vehicle_name(vehicle), axis, name, high[name].value - low[name].value,
                    half_of(low[name], low_own[name], name, 1), half_of(high[name], high_own[name], name, -1),
                    1.0 if vehicle.within else 2 / (telling - 1),
                ))  # fmt: skip
    return out


def likelihood(pairs: Sequence[Pair], scale: float) -> float:
    """Weighted logarithm of the likelihood of the differences, averaged over the spread."""
    total, t = 0.0, scale * GRID
    for pair in pairs:
        variance = sum(half.error**2 * (half.doubt**2 + t**2) for half in (pair.below, pair.above))
        density = np.exp(-0.5 * pair.difference**2 / variance) / np.sqrt(variance)
        total += pair.weight * math.log(max(float(SHARE @ density), 1e-300))
    return total


def scale_of(pairs: Sequence[Pair]) -> float:
    return max(SCALES, key=lambda scale: likelihood(pairs, scale))


def scales_of(pairs: Sequence[Pair]) -> dict[str, float]:
    """Scale of every coefficient with enough pairs, and `others` of the rest together."""
    groups: dict[str, list[Pair]] = defaultdict(list)
    for pair in pairs:
        groups[pair.name].append(pair)
    out = {name: scale_of(group) for name, group in groups.items() if len(group) >= LEAST_PAIRS}
    return out | {"others": scale_of(pairs)}


def z_of(pair: Pair, scales: dict[str, float]) -> float:
    """Difference in standard errors of it, under other scales."""
    wide = widening(scales.get(pair.name, scales["others"])) ** 2 - 1
    error = math.hypot(*(half.error * math.sqrt(half.doubt**2 + wide) for half in (pair.below, pair.above)))
    return pair.difference / error


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--cache", type=Path, required=True)
    options = parser.parse_args()
    if not options.data.is_dir():
        raise SystemExit(f"{options.data}: no recordings there; name their folder with --data")
    pairs: list[Pair] = []
    for vehicle in VEHICLES:
        pairs += pairs_of(
            vehicle, [fitted(options.data, log, options.structure, options.cache) for log in vehicle.logs]
        )
    everywhere = scales_of(pairs)
    left_out: list[Judged] = []
    for name in sorted({pair.vehicle for pair in pairs}):
        scales = scales_of([pair for pair in pairs if pair.vehicle != name])
        mine = [Judged(name, p.axis, p.name, ("", ""), z_of(p, scales), True) for p in pairs if p.vehicle == name]
        row = row_of(mine)
        print(f"without {name:20}{row['n']:5.0f} pairs {100 * row['inside']:4.0f} % {row['factor']:5.2f}")
        left_out += mine
    print(f"\n{'coefficient':20}{'scale':>7}{'pairs':>7}{'made with all':>17}{'left out':>16}")
    for name in [*sorted({pair.name for pair in pairs}), ""]:
        made = [Judged("", p.axis, p.name, ("", ""), z_of(p, everywhere), True) for p in pairs if name in (p.name, "")]
        out = row_of([p for p in left_out if name in (p.name, "")])
        row, scale = row_of(made), everywhere.get(name, everywhere["others"])
        print(f"{name or 'all':20}{scale:7.2f}{row['n']:7.0f}{100 * row['inside']:12.0f} %{row['factor']:5.2f}"
              f"{100 * out['inside']:11.0f} %{out['factor']:5.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
