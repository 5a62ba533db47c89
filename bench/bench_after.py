"""Recorded flights, each tracked from the model of another flight of the vehicle: is it taken for another vehicle?

    python bench/bench_after.py [--data FOLDER] [--structure LAW] [--every] [--cache FOLDER]

The vehicles and flights are those of `bench_real_coverage.py`, as is the cache. Each flight, or part, is fitted alone;
then each is tracked as if live with `--after` the model of the previous flight (`--every`: of every other flight).
Printed: alarms that it is another vehicle, alarms of other causes, and the number of comparisons outside their 95 %
intervals at the end. A flight that excites only one axis allows few comparisons. No recording is part of the project.
"""

import argparse
from pathlib import Path

from bench_real_coverage import VEHICLES, card_of, fitted
from rotorfit.app.workflows import load_flight
from rotorfit.core.errors import RotorfitError
from rotorfit.files.log_span import parse_log
from rotorfit.tracking.earlier import Earlier
from rotorfit.tracking.replayed import tracked


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--every", action="store_true")
    parser.add_argument("--cache", type=Path, help="As of bench_real_coverage.py.")
    given = parser.parse_args()
    if not given.data.is_dir():
        raise SystemExit(f"{given.data}: no recordings there; name their folder with --data")
    pairs = other = apart = compared = raised = 0
    hours = 0.0
    for vehicle in VEHICLES:
        logs = vehicle.logs
        for j, log in enumerate(logs):
            where = parse_log(str(given.data / log))
            flight = load_flight(where, card_of(where.path))
            for i in range(len(logs)) if given.every else (j - 1,):
                if i < 0 or i == j or (vehicle.within and logs[i].split("@")[0] != log.split("@")[0]):
                    continue
                try:
                    earlier = Earlier(fitted(given.data, logs[i], given.structure, given.cache), logs[i])
                    track = tracked(flight, given.structure, earlier=earlier)
                except RotorfitError as error:
                    print(f"{log} after {logs[i]}: {error}")
                    continue
                pairs, hours = pairs + 1, hours + flight.duration / 3600.0
                for alarm in track.alarms:
                    print(f"{log} after {logs[i]}: {alarm.time:.0f} s {alarm.cause}: {alarm.why}", flush=True)
                raised += sum(alarm.cause == "another_vehicle" for alarm in track.alarms)
                other += sum(alarm.cause != "another_vehicle" for alarm in track.alarms)
                for axis in track.states[-1].axes.values():
                    for name, (_, low, high) in axis.against.items():
                        same = 0.0 if name in ("delay", "lag", "total_lag") else 1.0
                        compared, apart = compared + 1, apart + (not low <= same <= high)
    print(
        f"{pairs} flights after another, {60 * hours:.0f} minutes: {raised} times another vehicle, {other} other alarms"
    )
    print(f"{apart} of {compared} quantities differ by more than their 95 % intervals at the end")


if __name__ == "__main__":
    main()
