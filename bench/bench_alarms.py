"""Which changes of a vehicle does `rotorfit track` tell, how soon, as what, and how often is it wrong?

    python bench/bench_alarms.py [FLIGHTS] [--hours H] [--structure S] [--jobs N] [--causes a,b]

Flights of the flight room (see `changing_flights.py`): 6 degrees of freedom, rotors, gusts, a radio; tilt- and
velocity-commanded vehicles, open and closed loop, gusts of 0.3 and 1 m/s.

- false alarms: H hours (default 1) in which nothing changes but the wind, in flights of 120 s.
- found: of FLIGHTS (default 8) flights of each change, after 60 s of learning: how many within 60 s, median and 95 %
  of the time until the alarm, and what it was named.
"""

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from changing_flights import CAUSES, Scenario, changing_flight
from rotorfit.tracking.replayed import growing
from rotorfit.tracking.tracker import Following


@dataclass(frozen=True)
class Raised:
    """The alarms of one flight: time after the change (before it: a false one), and named causes."""

    scenario: Scenario
    false: tuple[tuple[float, str, tuple[str, ...], float], ...]
    found: tuple[tuple[float, str, tuple[str, ...], float], ...]


def raised(job: tuple[int, Scenario, str]) -> Raised:
    """Flies a scenario and tracks it to its first alarm after the change."""
    seed, scenario, structure = job
    flown = changing_flight(seed, scenario)
    following, false, found = Following(structure), [], []
    for part, now in growing(flown.flight, following.next_look):
        for alarm in following.look(part, now).alarms:
            told = alarm.time - (flown.change or 0.0), alarm.cause, alarm.axes, alarm.p_value
            (false if flown.change is None or now < flown.change else found).append(told)
        if found:
            break
    return Raised(scenario, tuple(false), tuple(found))


def jobs_of(cause: str, count: int, first: int, structure: str) -> list[tuple[int, Scenario, str]]:
    """So many flights of a change, over vehicles, loops and gusts in turn."""
    kinds = [
        Scenario(cause, vehicle, loop, gusts)
        for gusts in (0.3, 1.0)
        for vehicle in ("bebop2", "tello")
        for loop in ("closed", "open")
    ]
    return [(first + n, kinds[n % len(kinds)], structure) for n in range(count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flights", nargs="?", type=int, default=8)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--causes", default=",".join(cause for cause in CAUSES if cause not in ("none", "wind")))
    given = parser.parse_args()
    with ProcessPoolExecutor(given.jobs) as pool:
        for number, cause in enumerate(("none", "wind")):
            jobs = jobs_of(cause, round(given.hours * 15), 10_000 * number, given.structure)
            told = list(pool.map(raised, jobs))
            alarms = [one for each in told for one in each.false]
            hours = sum(each.scenario.duration for each in told) / 3600
            print(f"{cause:10} {len(alarms)} false alarms in {hours:.2f} h {alarms or ''}", flush=True)
        for number, cause in enumerate(given.causes.split(","), 2):
            told = list(pool.map(raised, jobs_of(cause, given.flights, 10_000 * number, given.structure)))
            when = np.array([each.found[0][0] if each.found else np.inf for each in told])
            names = Counter(each.found[0][1] for each in told if each.found)
            early = sum(len(each.false) for each in told)
            median, late = np.quantile(when, [0.5, 0.95], method="higher")
            print(
                f"{cause:10} found {np.isfinite(when).sum()} of {len(told)}, after {median:.0f} s (median), "
                f"{late:.0f} s (95 %); named {dict(names)}; {early} false alarms before",
                flush=True,
            )
            for each in told:
                scenario = each.scenario
                print(
                    f"    {scenario.vehicle:8} {scenario.loop:7} {scenario.gusts:3} m/s  {each.found or '-'}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
