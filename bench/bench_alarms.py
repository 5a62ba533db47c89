"""Which changes of a vehicle does `rotorfit track` detect, how soon, and as what; how soon could they be detected?

    python bench/bench_alarms.py [FLIGHTS] [--causes a,b] [--gusts 0.3,1] [--structure S] [--jobs N] [--first SEED]
                                 [--learning SECONDS] [--false-alarms-per-hour N] [--json FILE]

Flights of the flight room (see `changing_flights.py`): 6 degrees of freedom, rotors, gusts, a radio; FLIGHTS (default
2) of each change for each strength of gusts, each of two vehicles (a Bebop 2 by tilts, a Tello by velocities), and each
loop. 60 s of learning; the change comes within the second after. Flights with different changes are identical until
then, so each is learnt once.

- found: share detected within 20 s (a fading battery: 65 s); time from the change to the alarm, median and 95 %; the
  cause that was named, at once and by the revision; how often the interval of its instant holds the truth, and how
  many intervals of its size do, where the cause was named rightly.
- knowing: a test that knows course and size of the change, but not its time. It correlates with the innovations of the
  changed flight less those of the same flight unchanged, both under the estimate before the change, once a second, at a
  threshold with the same rate of false alarms over the same number of windows. What it does not find cannot be found.
- as often: the same test as often as the tracker glances.
- ratios: median time to the alarm over that of either, for flights in which both find the change.

False alarms are counted by `bench_alarm_pvalues.py`; those before a change are counted here, too.
"""

import argparse
import copy
import json
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from changing_flights import CAUSES, SLOWER, ChangingFlight, Scenario, changing_flight
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.limits import GRAVITY
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Alarm
from rotorfit.tracking.change_watch import GLANCE, REVISED
from rotorfit.tracking.following import EVERY, FALSE_ALARMS_PER_HOUR, Following
from rotorfit.tracking.groups import scores_of_groups
from rotorfit.tracking.growing_flight import GrowingFlight
from rotorfit.tracking.refits import applied
from rotorfit.tracking.replayed import growing, until
from rotorfit.tracking.scores import WINDOWS, Scores

LEARNT, WITHIN, SLOW = 60.0, 20.0, 65.0
"""The change comes within the second after the first; it counts as found within the second, or the third [s]."""

TRUE = {
    "picked_up": "payload", "dropped": "payload", "propeller": "thrust", "battery": "payload", "limits": "limits",
    "delay": "delay", "frame": "pose_jumped", "heading": "pose_jumped", "frozen": "pose_frozen",
}  # fmt: skip
"""What each change is to be named. Thrust lost evenly is the same push as a payload."""

RATIOS = ("input", "damping")
"""Coefficients whose change is a ratio."""

OF_THE_POSE = ("frame", "heading", "frozen")


@dataclass(frozen=True)
class Told:
    """What became of one change.

    Attributes:
        cause: What changed.
        vehicle, loop, gusts, seed: The flight.
        found: Time to the alarm [s]; None where none was raised.
        first: As what, when it was raised; None likewise.
        named: As what in the end; None likewise.
        dated: Whether the interval of its instant holds the truth, at once and in the end; None likewise.
        sized: How many intervals of its size hold the truth, and of how many; None where the cause is wrong.
        knowing: Time of the test that knows, once a second [s]; None where it finds nothing.
        often: The same as often as the tracker glances.
        early: False alarms before.
    """

    cause: str
    vehicle: str
    loop: str
    gusts: float
    seed: int
    found: float | None
    first: str | None
    named: str | None
    dated: tuple[bool, bool] | None
    sized: tuple[int, int] | None
    knowing: float | None
    often: float | None
    early: int


def told_of(job: tuple[int, Scenario, Sequence[str], tuple[str, float]]) -> list[Told]:
    """Flies a scenario up to its change once, and on from there under each of some changes."""
    seed, scenario, causes, promised = job
    moment = LEARNT + float(np.random.default_rng((seed, 4)).uniform())
    scenario = replace(scenario, time=moment, duration=moment + SLOW + 2.0)
    told, learnt = [], {}
    for cause in causes:
        plain = replace(scenario, cause="none")
        if cause == "limits" and scenario.vehicle == "bebop2":  # slower from the start
            plain = replace(scenario, cause="limits", time=scenario.duration + 1.0)
        if plain not in learnt:
            learnt[plain] = (changing_flight(seed, plain), *_learnt(changing_flight(seed, plain).flight, *promised))
        base, following, early = learnt[plain]
        flown = changing_flight(seed, replace(scenario, cause=cause))  # type: ignore[arg-type]
        within = SLOW if cause == "battery" else WITHIN
        raised = _of_pose(flown, within) if cause in OF_THE_POSE else None
        raised = raised or _raised(copy.deepcopy(following), flown.flight, moment, within)
        known = (None, None) if cause in OF_THE_POSE else _knowing(following, base, flown, moment, within, promised[1])
        flight = scenario.vehicle, scenario.loop, scenario.gusts, seed
        told.append(Told(cause, *flight, *_outcome(raised, moment), _sized(raised, flown), *known, early))
    return told


def _learnt(flight: Flight, structure: str, rate: float) -> tuple[Following, int]:
    """The tracker before the change, and how many alarms it has raised."""
    following, alarms = Following(structure, rate), 0
    for part, now in growing(until(flight, LEARNT + 1e-6), following.next_look, GLANCE):
        state = following.follow(part, now)
        alarms += sum(alarm.revises is None for alarm in state.alarms) if state else 0
    return following, alarms


def _outcome(
    raised: tuple[Alarm, Alarm] | None, moment: float
) -> tuple[float | None, str | None, str | None, tuple[bool, bool] | None]:
    """Time to an alarm, its names and whether its instants hold, at once and in the end."""
    if raised is None:
        return None, None, None, None
    first, last = raised
    held = [one.since[0] <= moment <= one.since[1] for one in raised]
    return first.time - moment, first.cause, last.cause, (held[0], held[1])


def _sized(raised: tuple[Alarm, Alarm] | None, flown: ChangingFlight) -> tuple[int, int] | None:
    """How many intervals of the size of a change hold the truth, and of how many."""
    cause = flown.scenario.cause
    if raised is None or raised[1].cause != TRUE[cause] or cause in OF_THE_POSE:
        return None
    (before, after), true = flown.linear, dict[str, float]()
    for a, axis in enumerate(AXES):
        true |= {f"{axis}.{name}": after.gamma[2 * a + k] / before.gamma[2 * a + k] for k, name in enumerate(RATIOS)}
        true[f"{axis}.delay"] = SLOWER if cause == "delay" else after.delay[a] - before.delay[a]
    if cause in ("picked_up", "dropped"):
        true["z.trim"] = GRAVITY * (flown.before.mass / flown.after.mass - 1)
    held = [bool(low <= true[name] <= high) for name, (low, high) in raised[1].change.items() if name in true]
    return sum(held), len(held)


def _raised(following: Following, flight: Flight, moment: float, within: float) -> tuple[Alarm, Alarm] | None:
    """The first alarm after the change, as it was raised and as it was revised."""
    first: Alarm | None = None
    for part, now in growing(flight, LEARNT + GLANCE, GLANCE):
        if now > moment + within + (REVISED if first else 0.0):
            break
        for alarm in state.alarms if (state := following.follow(part, now)) else ():
            if first and alarm.revises == first.time:
                return first, alarm
            first = first or alarm
    return (first, first) if first else None


def _of_pose(flown: ChangingFlight, within: float) -> tuple[Alarm, Alarm] | None:
    """The same of what the pose raises by itself, sample by sample."""
    room, moment = flown.room, flown.scenario.time
    growing = GrowingFlight(flown.flight.card, origin=0)
    samples = [
        Sample(kind, int(stamp), int(received), tuple(map(float, values)))
        for kind, stamps, arrivals, rows in (
            ("pose", room.pose_stamp, room.pose_received, room.pose),
            ("command", room.command_stamp, room.command_stamp, room.command),
        )
        for stamp, received, values in zip(stamps, arrivals, rows, strict=True)
        if moment - 5.0 < received / 1e9 < moment + within
    ]
    for sample in sorted(samples, key=lambda one: one.received):
        growing.add(sample)
        for alarm in growing.alarms():
            return alarm, alarm
    return None


def _knowing(
    following: Following, base: ChangingFlight, flown: ChangingFlight, moment: float, within: float, rate: float
) -> tuple[float | None, float | None]:
    """When a test that knows the course of the change would have sounded, once a second and at every glance."""
    end = float(np.floor(moment + within))
    seen = list(zip(*(_innovations(following, until(one.flight, end)) for one in (flown, base)), strict=True))
    first, second = (_sounds(seen, moment, end, every, rate) for every in (EVERY, GLANCE))
    return first, second


def _sounds(
    seen: Sequence[tuple[Scores, Scores]], moment: float, end: float, every: float, rate: float
) -> float | None:
    """The same for one time between looks [s], from the innovations with and without the change."""
    from scipy.special import ndtri

    threshold = -float(ndtri(rate * every / 3600.0 / len(WINDOWS)))
    for now in np.arange(np.ceil(moment / every) * every, end + every / 2, every):
        product = power = 0.0
        for changed, unchanged in seen:
            at, last = (int(np.searchsorted(changed.time, t)) for t in (moment, now))
            shape = changed.innovation[at:last] - unchanged.innovation[at:last]
            if not shape.any():
                continue
            usual = _usual(unchanged.innovation[:at], shape, unchanged)
            product += float(shape @ changed.innovation[at:last]) / usual
            power += float(shape @ shape) / usual
        if power > 0 and product / np.sqrt(power) > threshold:
            return float(now - moment)
    return None


def _usual(before: np.ndarray, shape: np.ndarray, scores: Scores) -> float:
    """What the innovations before the change, over those that are white, give along a shape: their colour and gusts."""
    width = 2 if np.any(np.diff(scores.time) == 0) else 1  # x and y of a block stand side by side
    shape = shape[: before.size // 2]
    along = np.correlate(before, shape, "valid")[::width]
    return max(float(np.mean(along**2)) / max(float(shape @ shape), 1e-12), 1.0)


def _innovations(following: Following, flight: Flight) -> list[Scores]:
    """Those of a flight under the estimates of a tracker."""
    known = [group.fitted for group in following.learnt.groups.values() if group.fitted]
    return scores_of_groups([applied(one, flight) for one in known], flight)


def scenarios(flights: int, gusts: Sequence[float], first: int, learning: float) -> list[tuple[int, Scenario]]:
    """Seeds and flights of autopilots that learn a push within `learning` [s], over gusts, vehicles and loops."""
    kinds = [
        Scenario("none", vehicle, loop, one, learning=learning)
        for one in gusts
        for vehicle in ("bebop2", "tello")
        for loop in ("closed", "open")
    ]
    return [(first + n, kinds[n % len(kinds)]) for n in range(flights * len(kinds))]


def report(told: Sequence[Told]) -> None:
    """Prints what became of each change, by gusts, and what was taken for what."""
    times = f"{'median':>7} {'95 %':>6}"
    tests = f"{'knowing':>10} {times} {'ratio':>6} {'as often':>10} {times} {'ratio':>6}"
    print(f"{'change':10}{'gusts':>6} {'found':>10} {'named':>6} {times} {tests}")
    for cause in dict.fromkeys(one.cause for one in told):
        for gusts in sorted({one.gusts for one in told}):
            some = [one for one in told if one.cause == cause and one.gusts == gusts]
            found = _or_never([one.found for one in some])
            named = sum(one.named == TRUE[cause] for one in some)
            line = f"{cause:10}{gusts:6g} {np.isfinite(found).sum():4} of {len(some):2} {named:6} {_times(found)}"
            for known in ([one.knowing for one in some], [one.often for one in some]):
                if cause not in OF_THE_POSE:
                    knowing = _or_never(known)
                    both = np.isfinite(found) & np.isfinite(knowing)
                    ratio = f"{np.median(found[both]) / np.median(knowing[both]):6.2f}" if both.any() else f"{'-':>6}"
                    line += f" {np.isfinite(knowing).sum():4} of {len(some):2} {_times(knowing)} {ratio}"
            print(line, flush=True)
    names = ("payload", "thrust", "limits", "delay", "pose_jumped", "pose_frozen", "other", None)
    for when in ("first", "named"):
        title = "at once" if when == "first" else "in the end"
        print(f"\n{title:10}" + "".join(f"{name or 'nothing':>12}" for name in names))
        for cause in dict.fromkeys(one.cause for one in told):
            count = Counter(getattr(one, when) for one in told if one.cause == cause)
            print(f"{cause:10}" + "".join(f"{count[name]:12}" for name in names))
    print(f"\n{'instant':10}{'at once':>12}{'in the end':>12}")
    for cause in dict.fromkeys(one.cause for one in told):
        held = [one.dated for one in told if one.cause == cause and one.dated]
        print(f"{cause:10}" + "".join(f"{sum(some):6} of {len(held):2}" for some in zip(*held, strict=True)))
    print(f"\n{'size':10}{'holds':>12}")
    for cause in dict.fromkeys(one.cause for one in told):
        if sizes := [one.sized for one in told if one.cause == cause and one.sized and one.sized[1]]:
            held, count = np.sum(sizes, axis=0)
            print(f"{cause:10}{held:6} of {count:2}")
    seen = {(one.seed, one.vehicle, one.loop, one.gusts, one.cause == "limits"): one.early for one in told}
    print(f"\n{sum(seen.values())} false alarms before, in {len(seen) * LEARNT / 3600:.2f} h", flush=True)


def _or_never(times: Sequence[float | None]) -> np.ndarray:
    return np.array([np.inf if one is None else one for one in times])


def _times(values: np.ndarray) -> str:
    median, late = np.quantile(values, [0.5, 0.95], method="higher")
    return f"{median:7.1f} {late:6.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flights", nargs="?", type=int, default=2)
    parser.add_argument("--causes", default=",".join(cause for cause in CAUSES if cause in TRUE))
    parser.add_argument("--gusts", default="0.3,1")
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--learning", type=float, default=1.0, help="time constant with which autopilots learn [s]")
    parser.add_argument("--false-alarms-per-hour", dest="rate", type=float, default=FALSE_ALARMS_PER_HOUR)
    parser.add_argument("--json", type=Path, help="each change, a line; what it holds already is reported, too")
    given = parser.parse_args()
    causes, gusts = given.causes.split(","), [float(one) for one in given.gusts.split(",")]
    told = []
    if given.json and given.json.exists():
        told = [Told(**json.loads(line)) for line in given.json.read_text().splitlines()]
    jobs = [
        (seed, one, causes, (given.structure, given.rate))
        for seed, one in scenarios(given.flights, gusts, given.first, given.learning)
    ]
    with ProcessPoolExecutor(given.jobs) as pool:
        for some in pool.map(told_of, jobs):
            told += some
            if given.json:
                with given.json.open("a") as out:
                    out.writelines(json.dumps(asdict(one)) + "\n" for one in some)
    report(told)


if __name__ == "__main__":
    main()
