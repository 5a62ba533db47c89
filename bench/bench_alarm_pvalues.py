"""Are the p-values of the alarms valid? Smallest p-value of every look, in flights in which nothing changes.

    python bench/bench_alarm_pvalues.py [HOURS] [--kinds a,b] [--structure S] [--first N]
                                         [--false-alarms-per-hour N] [--json FILE]

An alarm is raised where the smallest p-value of a look, times the number of contrasts that were tested, falls below
the share of the promised false-alarm rate that is allotted to one look. So at most a share q of all looks may have such
a value below q, for every q down to that threshold: this script counts them, and the alarms that were raised.

HOURS (default 0.5) of each kind:

- paper: the paper's vehicle, five coefficient sets, open and closed loop, coloured wind (see `designs.py`); 60 s.
- room: the flight room, 6 degrees of freedom, gusts of 0.3, 1 and 2 m/s, two vehicles, both loops; 120 s.
- wind: as `room`; a minute after the start wind rises to 3 m/s and gusts to four times their strength within 10 s.
- pilot: a Bebop 2 that brakes at zero command, flown by a pilot who releases the sticks; gusts of 0 to 1 m/s; 120 s.
- recorded: every flight of `../../shared/data`, independent of HOURS.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import rotorfit as rf
from changing_flights import Scenario, changing_flight, piloted_flight
from designs import designs
from designs import flown as flown_design
from rotorfit.core.flight_data import Flight
from rotorfit.tracking import change_watch, changes, following
from rotorfit.tracking.replayed import tracked

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
QUANTILES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)

Flown = Iterator[tuple[str, Flight, str]]


def paper(hours: float, first: int, _structure: str) -> Flown:
    """60 s each, under the law that these vehicles obey."""
    count = max(round(hours * 60), 2)
    for closed in (False, True):
        for n, design in enumerate(designs(count // 2, closed, seed=100 + first)):
            yield (
                f"{design.name} {'closed' if closed else 'open'} {first}/{n}",
                flown_design(design),
                "first_order_delay",
            )


def room(hours: float, first: int, structure: str, cause: str = "none") -> Flown:
    """120 s each."""
    kinds = [
        Scenario(cause, vehicle, loop, gusts)  # type: ignore[arg-type]
        for gusts in (0.3, 1.0, 2.0)
        for vehicle in ("bebop2", "tello")
        for loop in ("closed", "open")
    ]
    for n in range(first, first + max(round(hours * 30), 1)):
        one = kinds[n % len(kinds)]
        yield f"{one.vehicle} {one.loop} {one.gusts} {n}", changing_flight(500_000 + n, one).flight, structure


def wind(hours: float, first: int, structure: str) -> Flown:
    """Wind that rises."""
    return room(hours, first, structure, "wind")


def pilot(hours: float, first: int, structure: str) -> Flown:
    """A pilot who lets go, on a vehicle that brakes."""
    for n in range(first, first + max(round(hours * 30), 1)):
        gusts = (0.0, 0.3, 1.0)[n % 3]
        yield f"bebop2 {gusts} {n}", piloted_flight(700_000 + n, gusts), structure


def recorded(_hours: float, _first: int, structure: str) -> Flown:
    """What there is."""
    for path in sorted(DATA.glob("*/*")):
        card = path.parent / "card.toml"
        if path.suffix not in (".mat", ".bag", ".csv", ".mcap", ".ulg", ".bin", ".txt") or "clock" in path.name:
            continue
        try:
            flight = rf.flight(path, card=str(card)) if card.exists() else rf.flight(path)
        except rf.RotorfitError:
            continue  # no flight: rigid bodies without commands, format records only
        yield f"{path.parent.name}/{path.name}", flight, structure


KINDS = {"paper": paper, "room": room, "wind": wind, "pilot": pilot, "recorded": recorded}


class Looks:
    """Watches what a tracker looks at."""

    def __init__(self) -> None:
        self.seen: list[dict] = []
        self._looked = changes.looked_together

    def __call__(
        self, scored: Sequence[changes.Scores], lengths: Sequence[float] = changes.WINDOWS, back: float = changes.NEW
    ) -> tuple[dict, int]:
        looked, count = self._looked(scored, lengths, back)
        parts = []
        for names, found in looked.items():
            axes = "+".join(dict.fromkeys(name.split(".")[0] for name in names))
            parts += [(one.p_value, axes, round(float(one.since), 2), one.directions) for one in found]
        self.seen.append({"looks": count, "parts": sorted(parts)[:20]})
        return looked, count


def watched(flight: Flight, structure: str, rate: float) -> tuple[list[dict], list]:
    """What was seen at each look of a flight, and its alarms."""
    watch = change_watch.looked_together = Looks()
    alarms = tracked(flight, structure, rate).alarms
    return [one for one in watch.seen if one["looks"]], list(alarms)


def least(look: dict) -> float:
    """The least p-value of a look, times how many were looked at."""
    return min((p for p, *_ in look["parts"]), default=1.0) * look["looks"]


def table(name: str, seconds: float, values: np.ndarray, alarms: int) -> None:
    """A line of shares beside what is promised."""
    shares = " ".join(f"{np.mean(values < q):9.2g}" for q in QUANTILES)
    print(
        f"{name:10} {seconds / 3600:6.2f} h {values.size:7} looks  {shares}   least {values.min():.1e}  {alarms} alarms"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("hours", nargs="?", type=float, default=0.5)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--first", type=int, default=0, help="other seeds")
    parser.add_argument("--false-alarms-per-hour", dest="rate", type=float, default=following.FALSE_ALARMS_PER_HOUR)
    parser.add_argument("--json", type=Path, help="every look, a line a flight")
    given = parser.parse_args()
    print(f"share of looks whose least p-value, times the number looked at, is below {QUANTILES}")
    for kind in given.kinds.split(","):
        values, seconds, alarms = [], 0.0, 0
        for name, flight, structure in KINDS[kind](given.hours, given.first, given.structure):
            began = time.process_time()
            looks, raised = watched(flight, structure, given.rate)
            values += [least(one) for one in looks]
            seconds, alarms = seconds + flight.duration, alarms + len(raised)
            for one in raised:
                print(
                    f"    {name}: {one.cause} {one.axes} at {one.time:.0f} s, p {one.p_value:.1e}: {one.why}",
                    flush=True,
                )
            if given.json:
                told = {"kind": kind, "name": name, "structure": structure, "duration": flight.duration, "looks": looks}
                told |= {"alarms": [one.to_mapping() for one in raised], "cpu": time.process_time() - began}
                with given.json.open("a") as out:
                    out.write(json.dumps(told) + "\n")
        if values:
            table(kind, seconds, np.array(values), alarms)


if __name__ == "__main__":
    main()
