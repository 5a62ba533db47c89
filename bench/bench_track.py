"""Are the intervals of `rotorfit track` valid at every moment? Simulated flights of the coverage benchmark, as if live.

    python bench/bench_track.py [FLIGHTS] [--structure S] [--jobs N]

FLIGHTS (default 40) of 60 s in open loop and as many in closed loop, over five coefficient sets (see `designs.py`), by
default under `first_order_delay`, the law that these vehicles obey.

- covered: share of the 95 % intervals of input, damping and delay that contain the truth, 5, 10, 20, 40 s after the
  start and at landing, for the axes with numbers by then: this flight's (these vehicles obey their law) and the
  vehicle's.
- known: time until an axis is `known`, over the time at which the Cramer-Rao bound of the flight so far, taken as an
  interval, would first have been `known`: median.
- taken back: share of the axes that were `known` of which a later look says that they are not.
- landing: estimate of the last step before landing less that of the batch fit, in standard errors of the batch fit;
  beside it, for scale, the batch fit of the flight until then less that of the whole flight. Where the two fits differ
  in the law, a delay or a damping is not the same quantity in both: steady gain and total lag are compared.
- cost: processor seconds of tracking per second of flight, steps and refits separately.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from designs import Design, bounds, designs, flown, truth_of
from rotorfit.core.flight_data import Flight
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.coefficients import statuses
from rotorfit.estimation.likelihood.estimand import estimands
from rotorfit.tracking.change_watch import GLANCE
from rotorfit.tracking.following import Following
from rotorfit.tracking.replayed import growing, until

MOMENTS = (5.0, 10.0, 20.0, 40.0)
"""After the start [s]; and at landing."""

SAME = ("steady_gain", "total_lag")
"""Quantities that mean the same under every law."""


@dataclass(frozen=True)
class Told:
    """What came of one flight.

    Attributes:
        held: Moment (the last is landing) to whether each interval held the truth: this flight's, and the vehicle's.
        known: Time until known over the earliest possible, of each axis that both reached.
        ever: Number of axes that were ever known.
        back: Number of those that were taken back.
        off: Last step less the batch fit, in standard errors.
        late: Batch fit until the last step less that of the whole flight, likewise.
        laws: Number of axes whose law at the last step is not that of the batch fit.
        cost: Processor seconds a second of flight.
        steps: Of the looks without a refit, median [s].
        alarms: How many.
    """

    held: dict[float, list[tuple[bool, bool]]]
    known: list[float]
    ever: int
    back: int
    off: list[float]
    late: list[float]
    laws: int
    cost: float
    steps: float
    alarms: int


def told_of(job: tuple[Design, str]) -> Told:
    """Flies a design and tracks it."""
    design, structure = job
    flight = flown(design)
    following, held, first, looks, back = Following(structure), {}, {}, [], set()
    begun, alarms, state = time.process_time(), 0, None
    for part, now in growing(flight, following.next_look, GLANCE):
        before = time.process_time()
        told = following.follow(part, now)
        if told is None:  # a glance
            continue
        looks.append(time.process_time() - before)
        state, seen = told, part
        alarms += len(state.alarms)
        for axis, known in state.axes.items():
            if known.knowledge == "known":
                first.setdefault(axis, now)
            elif "taken back" in known.state:
                back.add(axis)
        if any(abs(now - moment) < 1e-6 for moment in MOMENTS):
            held[now] = _held(design, state)
    cost = (time.process_time() - begun) / flight.duration
    last = state
    state, _ = following.finish(flight, flight.segments[-1].end)
    held[np.inf] = _held(design, state)
    batch, until_then = (fit([one], structure=structure) for one in (flight, seen))
    told = {axis: (one.structure, one.values) for axis, one in last.axes.items()}
    late = {axis: (one.structure, _values(until_then, axis)) for axis, one in until_then.model.axes.items()}
    laws = sum(law != batch.model.axes[axis].structure for axis, (law, _) in told.items() if axis in batch.estimates)
    possible = _possible(design, flight)
    known = [first[axis] / possible[axis] for axis in flight.axes if axis in first and axis in possible]
    back |= {axis for axis, one in state.axes.items() if "taken back" in one.state}
    off, step = (_off(told, batch), _off(late, batch)), float(np.median(looks))
    return Told(held, known, len(first), len(back), *off, laws, cost, step, alarms)


def _values(found: Fit, axis: str) -> dict[str, float | None]:
    """What a fit tells of an axis."""
    one = found.model.axes[axis]
    together = {name: one.combinations[name].value for name in SAME if name in one.combinations}
    return {name: getattr(one, name) for name in COEFFICIENTS} | together


def _off(told: Mapping[str, tuple[str, Mapping[str, float | None]]], batch: Fit) -> list[float]:
    """Values of each axis under its law, less those of a fit, in standard errors of the fit."""
    out = []
    for axis, (law, values) in told.items():
        if axis not in batch.estimates:
            continue
        optimum, place = batch.estimates[axis].optimum, batch.estimates[axis].place
        known, one = _values(batch, axis), estimands(optimum, place)
        for name in COEFFICIENTS if law == batch.model.axes[axis].structure else SAME:
            value = values.get(name)
            if value is not None and known.get(name) is not None:
                by = np.log(value / one[name].value) if one[name].logarithmic else value - one[name].value
                out.append(float(by) / one[name].error(optimum))
    return out


def _held(design: Design, state) -> list[tuple[bool, bool]]:
    return [
        (_within(known.ci95_flight[name], true), _within(known.ci95[name], true))
        for axis, known in state.axes.items()
        for name, true in zip(COEFFICIENTS, truth_of(design, axis), strict=True)
        if name in known.ci95
    ]


def _within(ends, true: float) -> bool:
    low, high = ends
    return (low is None or low <= true) and (high is None or true <= high)


def _possible(design: Design, flight: Flight) -> dict[str, float]:
    """When each axis could have been known at the earliest: by the bound of the flight so far."""
    out: dict[str, float] = {}
    for now in np.arange(6.0, flight.duration):
        if len(out) == len(flight.axes):
            break
        found = bounds(design, until(flight, float(now)))
        for axis, errors in found.items():
            truth = truth_of(design, axis)
            ends = {n: (v - 1.96 * e, v + 1.96 * e) for n, v, e in zip(COEFFICIENTS, truth, errors, strict=True)}
            grow = np.exp(1.96 * errors[1] / truth[1])
            ends["damping"] = (truth[1] / grow, truth[1] * grow)
            if all(said == "ok" for said in statuses(ends).values()) and ends["input"][0] > 0:
                out.setdefault(axis, float(now))
    return out


def report(name: str, told: Sequence[Told]) -> None:
    """Prints the figures of one loop."""
    print(f"\n{name}: {len(told)} flights")
    for moment in (*MOMENTS, np.inf):
        held = [one for each in told for one in each.held.get(moment, [])]
        if held:
            when = "at landing" if np.isinf(moment) else f"at {moment:g} s"
            flight, vehicle = 100 * np.mean(held, axis=0)
            print(f"  {when:11} {flight:5.1f} % (the vehicle's {vehicle:.1f} %) of {len(held)} hold the truth")
    known, off, late = (np.concatenate([getattr(each, what) for each in told]) for what in ("known", "off", "late"))
    ever, back = (sum(getattr(each, what) for each in told) for what in ("ever", "back"))
    print(f"  {back} of {ever} axes that were known are taken back: {100 * back / ever:.1f} %")
    print(f"  known after {np.median(known):.2f} times the earliest time (median of {known.size} axes)")
    for what, values in (("last step", off), ("batch until then", late)):
        size = np.abs(values)
        print(
            f"  {what} off the batch by {np.median(size):.3f} (median), {np.quantile(size, 0.99):.3f} (99 %) std errors"
        )
    print(f"  {sum(each.laws for each in told)} axes under another law than that of the batch")
    cost, step = np.mean([each.cost for each in told]), np.median([each.steps for each in told])
    print(f"  {100 * cost:.1f} % of a core; a step {1e3 * step:.0f} ms")
    print(f"  {sum(each.alarms for each in told)} false alarms in {len(told) / 60:.1f} h")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flights", nargs="?", type=int, default=40)
    parser.add_argument("--structure", default="first_order_delay")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    with ProcessPoolExecutor(given.jobs) as pool:
        for closed in (False, True):
            jobs = [(design, given.structure) for design in designs(given.flights, closed)]
            report("closed loop" if closed else "open loop", list(pool.map(told_of, jobs)))


if __name__ == "__main__":
    main()
