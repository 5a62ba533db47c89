"""Two files, two clocks: how well are offset and drift estimated, are the intervals valid, is nonsense refused?

    python bench/bench_clocks.py [FLIGHTS]

Simulated flights of five published vehicles (the paper's vehicle, seeds from 0), 40 to 100 s, half of them under the
paper's two sines and half under steps, in wind. Offsets of 20 to 500 ms of either sign, in a quarter of the flights
with five minutes added; drifts to 100 us/s of either sign. The onboard sensors: see `CASES`. The true offset is that
in the middle of the commands. Where recorded flights are available, six of them are split into two files, too: they
have onboard velocity and pose in one file, so the offset estimated after the split, less the injected one, is the
unknown latency of their velocity and must be the same in all. These and six of an autopilot are split once more,
without onboard motion. Results: bench/clocks.json.
"""

import functools
import itertools
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from flights import steps  # noqa: E402 - it lies beside the tests
from rotorfit.core.card import Card  # noqa: E402
from rotorfit.core.errors import FlightError  # noqa: E402
from rotorfit.core.flight_data import ANSWER, Clocks  # noqa: E402
from rotorfit.core.log import Log, Table  # noqa: E402
from rotorfit.diagnosis.card_choice import card_of as card_of_log  # noqa: E402
from rotorfit.estimation.fitting import fit  # noqa: E402
from rotorfit.files.cards import card_from_mapping, load_card  # noqa: E402
from rotorfit.files.logs import read  # noqa: E402
from rotorfit.files.logs.several import join_logs  # noqa: E402
from rotorfit.flights.assemble import flight_from_log  # noqa: E402
from rotorfit.flights.columns import table_of  # noqa: E402
from rotorfit.planning.signals import two_sines  # noqa: E402
from rotorfit.simulation.paper_vehicle import STABLE, SimulatedFlight, Truth, simulate_flight  # noqa: E402
from twin_logs import Sensor, Skew, card_of, in_two_files  # noqa: E402

GOOD, FAIR, POOR = Sensor(), Sensor(15.0, 0.05, 0.02, 0.7), Sensor(10.0, 0.1, 0.03, 0.9)
CASES: Mapping[str, tuple[Sensor, Mapping[str, bool]]] = {
    "velocity and heading, 30 Hz, 0.03 m/s, 0.01 rad": (GOOD, {"velocity": True, "attitude": True}),
    "velocity, 30 Hz, 0.03 m/s": (GOOD, {"velocity": True}),
    "heading, 30 Hz, 0.01 rad": (GOOD, {"velocity": False, "attitude": True}),
    "velocity and heading, 15 Hz, 0.05 m/s, 0.02 rad": (FAIR, {"velocity": True, "attitude": True}),
    "velocity and heading, 10 Hz, 0.1 m/s, 0.03 rad": (POOR, {"velocity": True, "attitude": True}),
}
REAL = ROOT.parent / "shared" / "data" / "dji-hexarotor"


def drawn(seed: int) -> tuple[SimulatedFlight, Skew]:
    """A flight, and how its clocks stand."""
    rng = np.random.default_rng([20, seed])
    duration, yaw = rng.uniform(40, 100), rng.uniform(-3, 3)
    offset = rng.uniform(0.02, 0.5) * rng.choice([-1, 1]) + (300 if seed % 4 == 3 else 0)
    excitation: Callable[..., Any] = two_sines if seed % 2 else steps(seed=seed)
    truth = Truth(gamma=list(STABLE.values())[seed % 5])
    flight = simulate_flight(truth, excitation, duration, seed, initial_yaw=yaw)
    return flight, Skew(float(offset), float(rng.uniform(-1e-4, 1e-4)))


def clocks_of(log: Log, card: Mapping[str, bool]) -> Clocks | str:
    """What is found, or why nothing is."""
    try:
        return flight_from_log(log, card_of(**card)).clocks or "one file"
    except FlightError as error:
        return str(error)


def onboard_case(count: int, sensor: Sensor, card: Mapping[str, bool]) -> dict[str, Any]:
    """Figures of one kind of sensor."""
    errors, halves, drifts, drift_halves, left = [], [], [], [], 0
    for seed in range(count):
        flight, skew = drawn(seed)
        found = clocks_of(join_logs(in_two_files(flight, skew, sensor, seed)), card)
        if isinstance(found, str) or found.source != "onboard":
            left += 1
            continue
        errors.append(found.offset - skew.offset)
        halves.append(found.half_width)
        drifts.append(found.drift - skew.drift)
        drift_halves.append(found.drift_half_width)
    error, half, drift, drift_half = (np.array(each) for each in (errors, halves, drifts, drift_halves))
    sure = half < 0.002
    return {
        "flights": count,
        "refused": left,
        "rms_ms": 1e3 * float(np.sqrt(np.mean(error**2))),
        "median_ms": 1e3 * float(np.median(np.abs(error))),
        "within_2_ms": float(np.mean(np.abs(error) < 0.002)),
        "coverage": float(np.mean(np.abs(error) < half)),
        "half_width_ms": 1e3 * float(np.median(half)),
        "interval_below_2_ms": float(np.mean(sure)),
        "within_2_ms_of_those": float(np.mean(np.abs(error[sure]) < 0.002)) if np.any(sure) else None,
        "drift_rms_us_s": 1e6 * float(np.sqrt(np.mean(drift**2))),
        "drift_coverage": float(np.mean(np.abs(drift) < drift_half)),
    }


def command_case(count: int) -> dict[str, Any]:
    """Without a second source: how roughly, and whether it is always marked."""
    errors, marked, refused = [], 0, 0
    for seed in range(count):
        flight, skew = drawn(seed)
        found = clocks_of(join_logs(in_two_files(flight, skew)), {"velocity": False})
        if isinstance(found, str):
            refused += 1
            continue
        marked += found.includes_delay
        errors.append(found.offset - skew.offset - flight.truth.delay[0] + ANSWER)
    size = np.abs(errors)
    return {
        "flights": count,
        "refused": refused,
        "marked": marked,
        "rms_ms": 1e3 * float(np.sqrt(np.mean(size**2))),
        "largest_ms": 1e3 * float(np.max(size)),
    }


def wrong_case(count: int) -> dict[str, Any]:
    """Onboard motion of another flight beside the right commands; and two files of different flights.

    The other flight is of another vehicle under the other kind of commands.
    """
    sensors, files = 0, 0
    for seed in range(count):
        (flight, skew), (other, _) = drawn(seed), drawn(seed + 1001)
        vehicle, room = in_two_files(flight, skew)
        foreign, _ = in_two_files(other, skew)
        mixed = replace(vehicle, tables={**vehicle.tables, "odometry": foreign.tables["odometry"]})
        found = clocks_of(join_logs([mixed, room]), {"velocity": True, "attitude": True})
        sensors += isinstance(found, str) or bool(found.refused)
        files += isinstance(clocks_of(join_logs([foreign, room]), {"velocity": True, "attitude": True}), str)
    return {"flights": count, "sensor_refused": sensors, "files_refused": files}


def real_case() -> list[dict[str, float]]:
    """The recorded flights, cut in two: the latency of their velocity [ms] with its interval."""
    rng, out = np.random.default_rng(5), []
    card = load_card(str(REAL / "card.toml")) if REAL.is_dir() else None
    for path in sorted(REAL.glob("*.mat")) if card else []:
        assert card is not None
        log = read(path)
        (table,) = log.tables.values()
        skew = Skew(float(rng.uniform(0.02, 0.5) * rng.choice([-1, 1])), float(rng.uniform(-1e-4, 1e-4)))
        time = str(card.command_time.source)
        clock = table.columns[time].astype(np.float64).ravel()
        middle = float(np.mean(clock[[0, -1]]))
        own = middle - skew.offset + (clock - middle) / (1 + skew.drift)
        vehicle = replace(log, path=Path("v.mat"), tables={"v": Table("v", {**table.columns, time: own})})
        room = replace(log, path=Path("r.mat"), tables={"r": Table("r", table.columns)})
        raw = {**card.raw, "command": _placed(card.raw["command"], "v"), "pose": _placed(card.raw["pose"], "r")}
        raw["velocity"] = {"frame": "heading", "x": "v:vf", "y": "v:vl", "z": "v:ve", "yaw": "v:w", "time": f"v:{time}"}
        found = flight_from_log(join_logs([vehicle, room]), card_from_mapping(raw, "cut")).clocks
        if found is None or found.source != "onboard":
            out.append({"refused": 1.0})
            continue
        out.append({"latency_ms": 1e3 * (skew.offset - found.offset), "half_width_ms": 1e3 * found.half_width})
    return out


def alike_case() -> dict[str, dict[str, float]]:
    """Recorded flights, cut in two without onboard motion: how roughly placed, and how well moved to answer alike.

    Offset and delay together, about the mean of the vehicle; and how far two flights stand apart, as read and fitted
    together [ms].
    """
    rng, out = np.random.default_rng(9), {}
    for folder, pattern in ((REAL, "*.mat"), (REAL.parent / "arducopter-sitl", "s0[1-6].mcap")):
        flights, skews = [], []
        for path in sorted(folder.glob(pattern)):
            skews.append(float(rng.uniform(-2, 2)))
            log = read(path)
            card = load_card(str(folder / "card.toml")) if pattern == "*.mat" else card_of_log(log)
            flights.append(flight_from_log(*_cut(log, card, skews[-1])))
        if not flights:
            continue
        read_as = [flight.clocks.offset - skew for flight, skew in zip(flights, skews, strict=True) if flight.clocks]
        raw, moved = [], []
        for i, j in itertools.combinations(range(len(flights)), 2):
            one, other = fit([flights[i], flights[j]], structure="first_order_delay").flights
            assert one.clocks
            assert other.clocks
            raw.append(read_as[i] - read_as[j])
            moved.append((one.clocks.offset - skews[i]) - (other.clocks.offset - skews[j]))
        rms = [1e3 * float(np.sqrt(np.mean(np.square(each)))) for each in (raw, moved)]
        out[folder.name] = {"sd_ms": 1e3 * float(np.std(read_as, ddof=1)), "apart_ms": rms[0], "moved_ms": rms[1]}
    return out


def _cut(log: Log, card: Card, offset: float) -> tuple[Log, Card]:
    """A log as two files without onboard motion, and their card; the poses' clock is ahead by the offset [s]."""
    (sent, clock), (seen, _) = (table_of(log, str(time.source)) for time in (card.command_time, card.pose_time))
    stamps = sent.columns[clock].ravel()
    own = stamps - (round(1e9 * offset) if stamps.dtype.kind == "i" else offset)
    vehicle = replace(log, path=Path("v.log"), tables={"v": Table("v", {**sent.columns, clock: own})})
    room = replace(log, path=Path("r.log"), tables={"r": Table("r", seen.columns)})
    raw = {key: value for key, value in card.raw.items() if key not in ("velocity", "attitude", "window")}
    raw |= {"command": _placed(card.raw["command"], "v"), "pose": _placed(card.raw["pose"], "r")}
    return join_logs([vehicle, room]), card_from_mapping(raw, "cut")


def _placed(section: Mapping[str, Any], table: str) -> dict[str, Any]:
    """The columns of a section, in another table."""
    plain = ("frame", "hold")
    return {
        key: value
        if key in plain or isinstance(value, int | float)
        else {**value, "from": f"{table}:{value['from'].rpartition(':')[2]}"}
        if isinstance(value, dict)
        else f"{table}:{value.rpartition(':')[2]}"
        for key, value in section.items()
    }


def main(count: int) -> None:
    """Runs all cases, prints them, and writes them."""
    cases: dict[str, Callable[[], Any]] = {
        "recorded flights, cut in two": real_case,
        "answer to the commands only, recorded flights, cut in two": alike_case,
        "wrong source": lambda: wrong_case(count // 4),
        "answer to the commands only": lambda: command_case(count // 2),
        **{name: functools.partial(onboard_case, count, *case) for name, case in CASES.items()},
    }
    results = {}
    for name, case in cases.items():
        results[name] = case()
        print(name, results[name], flush=True)
    (ROOT / "bench" / "clocks.json").write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
