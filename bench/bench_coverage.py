"""Coverage of the intervals and efficiency of the estimates: simulated flights, every method, open and closed loop.

    python bench/bench_coverage.py [FLIGHTS] [--methods ml,paper,...] [--structure NAME] [--seed N]

FLIGHTS (default 400) flights of 60 s in open loop and as many in closed loop, and half as many weak ones of 20 s; see
`designs.py` for what is drawn. Per coefficient:

- bias: mean error over the Cramer-Rao bound of its flight, and its t,
- rmse: root mean square of the same ratio, 1 being the best that any unbiased method can do,
- covered: share of 95 % intervals that contain the truth; a missing number counts as a miss on a well excited axis; in
  the weak table an interval counts wherever its status is `not_identifiable`,
- width: mean half width over 1.96 bounds,
- a coefficient is rejected where a binomial test rejects 95 % at a family-wise level of 1 %.

Intervals are those of "this flight": the vehicles obey the law, so no other error has to be covered. `ml` fits that
law, `first_order_delay`; `--structure averaged` gives it the laws that `fit` averages by default.
An axis with wide bounds (`designs.EXCITED`) goes to the weak table of its loop. Results: bench/coverage.json.
"""

import argparse
import json
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from designs import Design, bounds, designs, flown, truth_of, well_excited
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.fitting import fit

FAMILY = 0.01
"""Family-wise level of the test of the twelve coverages of a table."""

POOLED, POOLED_WEAK = (0.94, 0.96), (0.93, 1.0)
"""What the pooled coverage must lie between."""

RUNAWAY = 10.0
"""A published number further from the truth than this many bounds is a runaway."""

LAW = "first_order_delay"
"""What the vehicles obey, and every method but `ml` fits."""

METHODS = ("ml", "robust", "oe", "iv", "svf", "weak", "paper")


@dataclass(frozen=True)
class Row:
    """One coefficient of one flight by one method; errors and widths in Cramer-Rao bounds, NaN where there is none."""

    method: str
    axis: str
    name: str
    excited: bool
    error: float
    width: float
    inside: bool
    status: str


def rows_of(job: tuple[Design, Sequence[str], str]) -> list[Row]:
    """Flies one design and fits it by every method, `ml` with the structure."""
    design, methods, structure = job
    flight = flown(design)
    bound = bounds(design, flight)
    out = []
    for method in methods:
        model = fit([flight], method, structure=structure if method == "ml" else LAW).model
        for axis in AXES:
            known, truth = model.axes[axis], truth_of(design, axis)
            excited = well_excited(truth, bound[axis])
            for name, true, least in zip(COEFFICIENTS, truth, bound[axis], strict=True):
                low, high = known.ci95_flight.get(name, known.ci95[name])  # no other flight: these obey the law
                value = getattr(known, name)
                closed = low is not None and high is not None
                out.append(
                    Row(
                        method=method,
                        axis=axis,
                        name=name,
                        excited=excited,
                        error=np.nan if value is None else (value - true) / least,
                        width=(high - low) / 2 / (1.96 * least) if closed else np.nan,
                        inside=(low is None or low <= true) and (high is None or true <= high),
                        status=known.status[name],
                    )
                )
    return out


def table_of(rows: Sequence[Row], weak: bool) -> dict[str, dict[str, float | int | bool]]:
    """Figures of the twelve coefficients, and of all together."""
    names = [(axis, name) for axis in AXES for name in COEFFICIENTS]
    low, high = POOLED_WEAK if weak else POOLED
    table = {}
    groups = {f"{axis}.{name}": [r for r in rows if (r.axis, r.name) == (axis, name)] for axis, name in names}
    for key, group in [*groups.items(), ("all", list(rows))]:
        if not group:
            continue
        told = ("ok", "not_identifiable") if weak else ("ok",)
        hit = np.array([row.inside and row.status in told for row in group])
        error = np.array([row.error for row in group])
        width = np.array([row.width for row in group])
        known = error[np.isfinite(error)]
        p = binomtest(int(hit.sum()), hit.size, 0.95).pvalue
        table[key] = {
            "n": len(group),
            "bias": float(known.mean()) if known.size else None,
            "t": float(known.mean() / known.std(ddof=1) * np.sqrt(known.size)) if known.size > 2 else None,
            "rmse": float(np.sqrt(np.mean(known**2))) if known.size else None,
            "covered": float(hit.mean()),
            "width": float(np.nanmean(width)) if np.isfinite(width).any() else None,
            "missing": int(np.sum(~np.isfinite(error))),
            "runaways": int(np.sum(np.abs(known) > RUNAWAY)),
            "rejected": bool(p < FAMILY / len(names)) if key != "all" else not low <= hit.mean() <= high,
        }
    return table


def print_table(title: str, table: dict[str, dict[str, float | int | bool]]) -> None:
    print(f"\n{title}")
    print(
        f"{'coefficient':14}{'n':>6}{'bias':>8}{'t':>7}{'rmse':>8}{'covered':>9}{'width':>7}{'missing':>9}{'runaways':>9}"
    )
    for name, row in table.items():
        bias, t, rmse, width = (
            f"{row[key]:.2f}" if row[key] is not None else "-" for key in ("bias", "t", "rmse", "width")
        )
        print(
            f"{name:14}{row['n']:6d}{bias:>8}{t:>7}{rmse:>8}{row['covered']:9.3f}{width:>7}"
            f"{row['missing']:9d}{row['runaways']:9d}{' rejected' if row['rejected'] else ''}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flights", nargs="?", type=int, default=400)
    parser.add_argument("--methods", default="ml")
    parser.add_argument("--structure", default=LAW)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", dest="output", type=Path, default=Path(__file__).with_name("coverage.json"))
    options = parser.parse_args()
    methods = METHODS if options.methods == "all" else tuple(options.methods.split(","))
    start = time.perf_counter()
    tables: dict[str, dict[str, dict[str, dict[str, float | int | bool]]]] = {}
    with ProcessPoolExecutor() as pool:
        for loop, closed in (("open loop", False), ("closed loop", True)):
            for weak in (False, True):
                drawn = designs(options.flights // (2 if weak else 1), closed, weak, options.seed)
                jobs = [(design, methods, options.structure) for design in drawn]
                found = [row for part in pool.map(rows_of, jobs, chunksize=4) for row in part]
                for method in methods:
                    mine = [row for row in found if row.method == method]
                    if weak:
                        title, kept = f"{loop}, weak flights", mine
                    else:
                        title, kept = loop, [row for row in mine if row.excited]
                    table = table_of(kept, weak)
                    tables.setdefault(title, {})[method] = table
                    print_table(f"{title}, {method}, {len(drawn)} flights", table)
    elapsed = time.perf_counter() - start
    print(f"\n{elapsed:.0f} s")
    result = {"flights": options.flights, "seed": options.seed, "structure": options.structure, "tables": tables}
    options.output.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
