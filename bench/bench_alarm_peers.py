"""How soon do other live estimators detect that a vehicle has changed? Compared with rotorfit's alarm, same flights.

    python bench/bench_alarm_peers.py [FLIGHTS] [--gusts 0.3,1] [--jobs N] [--first SEED]

The flights are those of `bench_alarms.py` with a payload picked up, with 50 ms more delay, and with rising wind, where
the vehicle does not change and every alarm is false. Only z is used: x and y would require a model of the heading of
every peer. The peers are those of `bench_track_peers.py`, with the same help. None of them has an alarm of its own, so
each is given one: every second its estimate is compared with its estimate `MEMORY` earlier. The threshold is the
largest such difference within the last 20 s before the change, over all flights of a row, so it is chosen with
knowledge of the flights. Its false-alarm rate is high: over N flights one in about N times 20 s, where rotorfit
promises one in ten hours.

- `nis`: the usual innovation monitor: the mean of the squared innovations of the last 1, 2 or 5 s, of a Kalman filter
  with rotorfit's estimate before the change; the threshold is found in the same way.
"""

import argparse
from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product

import numpy as np

from bench_alarms import LEARNT, WITHIN, _innovations, _learnt, _raised, scenarios
from bench_track_peers import MEMORY, Told, by_paper, correlation, kalman, least_squares, signal_of
from changing_flights import ChangingFlight, Scenario, changing_flight
from rotorfit.core.frames import AXES
from rotorfit.tracking.following import Following
from rotorfit.tracking.replayed import until

CHANGES = ("picked_up", "delay", "wind")
AXIS = "z"
NOISE = 1e-3
"""Told to the extended Kalman filter; the room's poses have about as much [m]."""
GUST_TIME = 1.0
"""Told likewise [s]."""
OVER = (1.0, 2.0, 5.0)
"""Windows of squared innovations [s]."""

Course = dict[tuple[str, str], dict[float, float]]
"""Method and quantity to what it tells at each second."""


def course(flown: ChangingFlight, following: Following) -> Course:
    """What the peers tell, second by second, from `MEMORY` before the first second that counts."""
    out: Course = defaultdict(dict)
    delay, scenario = flown.linear[0].delay[AXES.index(AXIS)], flown.scenario
    strength = (max(scenario.gusts / 2, 0.05), GUST_TIME)
    for now in np.arange(MEMORY, LEARNT + WITHIN + 1.0):
        part = until(flown.flight, now)
        signal = signal_of(part, AXIS)
        every: Mapping[str, Told] = {
            "rls": least_squares(signal, delay, directional=False),
            "sift": least_squares(signal, delay, directional=True),
            "ekf": kalman(signal_of(part, AXIS, resampled=False), delay, strength, NOISE),
            "paper": by_paper(part, now).get(AXIS, {}),
            "xcorr": correlation(signal),
        }
        for method, told in every.items():
            for name, (value, _, _) in told.items():
                out[method, name][now] = value if name == "delay" else float(np.log(max(value, 1e-9)))
    for scores in _innovations(following, flown.flight):
        if np.any(np.diff(scores.time) == 0):
            continue  # x and y of a block stand side by side; z and yaw stand alone
        for over in OVER:
            for now in np.arange(MEMORY, LEARNT + WITHIN + 1.0):
                seen = scores.innovation[(scores.time > now - over) & (scores.time <= now)]
                if seen.size:
                    out["nis", f"{over:g} s"][now] = max(
                        float(np.mean(seen**2)), out["nis", f"{over:g} s"].get(now, 0.0)
                    )
    return out


def differences(method: str, told: Mapping[float, float]) -> dict[float, float]:
    """Of each second against `MEMORY` earlier; innovations stand for themselves."""
    if method == "nis":
        return dict(told)
    return {now: abs(value - told[now - MEMORY]) for now, value in told.items() if now - MEMORY in told}


def of_flight(job: tuple[int, Scenario, str]) -> tuple[Course, float, float | None]:
    """What the peers told, when it changed, and rotorfit's time to the alarm [s]."""
    seed, scenario, cause = job
    moment = LEARNT + float(np.random.default_rng((seed, 4)).uniform())
    scenario = replace(scenario, time=moment, duration=moment + WITHIN + 3.0)
    plain, flown = (changing_flight(seed, replace(scenario, cause=one)) for one in ("none", cause))  # type: ignore[arg-type]
    following, _ = _learnt(plain.flight, "averaged")
    told = course(flown, following)
    raised = _raised(following, flown.flight, moment, WITHIN)
    return told, moment, raised[0].time - moment if raised else None


def sounded(courses: Sequence[tuple[Course, float, float | None]]) -> dict[str, list[float]]:
    """Method to its time to the alarm on each flight; infinite where there is none."""
    out: dict[str, list[float]] = defaultdict(list)
    for method in dict.fromkeys(method for told, _, _ in courses for method, _ in told):
        names = dict.fromkeys(name for told, _, _ in courses for one, name in told if one == method)
        most = {
            name: max(
                (
                    off
                    for told, moment, _ in courses
                    for now, off in differences(method, told.get((method, name), {})).items()
                    if now < moment
                ),
                default=np.inf,
            )
            for name in names
        }
        for told, moment, _ in courses:
            after = [
                now - moment
                for name in names
                for now, off in differences(method, told.get((method, name), {})).items()
                if now > moment and off > most[name]
            ]
            out[method].append(min(after, default=np.inf))
    out["track"] = [np.inf if alarm is None else alarm for _, _, alarm in courses]
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flights", nargs="?", type=int, default=2)
    parser.add_argument("--gusts", default="0.3,1")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    given = parser.parse_args()
    with ProcessPoolExecutor(given.jobs) as pool:
        for cause, gusts in product(CHANGES, [float(one) for one in given.gusts.split(",")]):
            flights = scenarios(given.flights, [gusts], given.first)
            courses = list(pool.map(of_flight, [(seed, scenario, cause) for seed, scenario in flights]))
            print(f"\n{cause}, gusts {gusts:g} m/s: found of {len(flights)}, time to the alarm [s], median of those")
            for method, times in sounded(courses).items():
                found = [one for one in times if np.isfinite(one)]
                median = f"{np.median(found):6.1f}" if found else f"{'-':>6}"
                print(f"{method:8}{len(found):4}{median}", flush=True)


if __name__ == "__main__":
    main()
