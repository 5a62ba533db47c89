"""How long a command acts: told by the motion through the gaps, not by three median periods."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.core.log import Log, Table
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log

G, B, DELAY = 4.0, 0.8, 0.15
STEP = 1e-3


def loop_stamps(rng: np.random.Generator, duration: float, share: float, low: float, high: float) -> Array:
    """A loop of 33 ms that now and then takes `low` to `high` seconds."""
    steps = 0.033 * rng.uniform(0.8, 1.2, round(duration / 0.02))
    late = rng.random(steps.size) < share
    steps[late] = rng.uniform(low, high, int(late.sum()))
    time = np.cumsum(steps)
    return time[time < duration]


def one_table(
    seed: int = 0,
    duration: float = 60.0,
    share: float = 0.08,
    gaps: tuple[float, float] = (0.1, 0.2),
    time_out: float = np.inf,
    noise: float = 0.001,
) -> Log:
    """A log of one table, its rows where the loop ran; the vehicle keeps a command, but no longer than its time-out."""
    rng = np.random.default_rng(seed)
    time = loop_stamps(rng, duration, share, *gaps)
    level = rng.integers(-1, 2, 200) * 0.3
    command = level[np.searchsorted(np.cumsum(rng.uniform(0.4, 1.2, 200)), time)]
    fine = np.arange(0.0, duration + STEP, STEP)
    row = np.searchsorted(time, fine - DELAY, side="right") - 1
    acting = (row >= 0) & (fine - DELAY - time[np.maximum(row, 0)] <= time_out)
    u = np.where(acting, command[np.maximum(row, 0)], 0.0)
    gust = np.zeros(fine.size)
    for i, shock in enumerate(rng.standard_normal(fine.size - 1)):
        gust[i + 1] = gust[i] * (1 - STEP) + 0.03 * np.sqrt(2 * STEP) * shock
    v = np.zeros(fine.size)
    for i in range(fine.size - 1):
        v[i + 1] = v[i] + STEP * (G * u[i] - B * v[i] + gust[i])
    x = np.interp(time, fine, np.cumsum(v) * STEP) + noise * rng.standard_normal(time.size)
    zero = np.zeros(time.size)
    columns = {"time": time, "u": command, "x": x, "y": zero, "z": zero + 1, "yaw": zero}
    return Log(Path("loop.csv"), "csv", "0" * 64, {"loop": Table("loop", columns)}, {})


CARD = {
    "command": {"time": "time", "x": "u"},
    "pose": {"time": "time", "x": "x", "y": "y", "z": "z", "yaw": "yaw"},
}


def flight_of(log: Log, hold: float | None = None) -> Flight:
    raw = {**CARD, "command": {**CARD["command"], **({"hold": hold} if hold else {})}}
    return flight_from_log(log, card_from_mapping(raw, "test"))


def told(flight: Flight) -> str:
    return {note.code: note.text for note in flight.notes}.get("hold_judged", "")


@pytest.mark.parametrize("seed", range(4))
def test_a_jittered_loop_with_gaps_of_a_tenth_or_two_keeps_the_whole_flight(seed: int) -> None:
    flight = flight_of(one_table(seed))

    assert len(flight.segments) == 1
    assert flight.duration > 59
    assert "through" in told(flight)
    assert "the last command is assumed to keep acting" in told(flight)


def test_its_coefficients_are_those_of_a_stated_hold_and_hold_the_truth() -> None:
    judged, stated = (fit([flight_of(one_table(1), hold)], axes=("x",)).model.axes["x"] for hold in (None, 0.3))

    assert judged.status == dict.fromkeys(judged.status, "ok")
    for name, truth in (("input", G), ("damping", B), ("delay", DELAY)):
        assert getattr(judged, name) == pytest.approx(truth, rel=0.03)
        assert getattr(judged, name) == pytest.approx(getattr(stated, name), rel=1e-6)


def test_gaps_of_a_second_are_bridged_where_the_vehicle_follows_the_held_command_through_them() -> None:
    flight = flight_of(one_table(2, share=0.02, gaps=(0.6, 1.0)))

    assert len(flight.segments) == 1
    assert "the vehicle followed" in told(flight)


@pytest.mark.parametrize("seed", range(3))
def test_a_vehicle_that_gives_up_after_a_tenth_of_a_second_is_not_taken_to_follow(seed: int) -> None:
    flight = flight_of(one_table(seed, time_out=0.1, share=0.15, gaps=(0.2, 0.24)))

    assert len(flight.segments) > 10
    assert "is assumed to have ended: the vehicle followed" in told(flight)


def test_long_gaps_of_which_the_motion_says_nothing_stay_gaps() -> None:
    log = one_table(3, share=0.02, gaps=(0.6, 1.0))
    still = replace(log.tables["loop"], columns=log.tables["loop"].columns | {"x": 1e-3 * np.arange(log_rows(log))})
    flight = flight_of(replace(log, tables={"loop": still}))

    assert len(flight.segments) > 10
    assert "is assumed to have ended" in told(flight)


def log_rows(log: Log) -> int:
    return len(log.tables["loop"].columns["time"])


def test_a_stated_hold_is_not_judged() -> None:
    flight = flight_of(one_table(1), hold=0.15)

    assert len(flight.segments) > 3
    assert told(flight) == ""


def test_a_gap_that_passes_the_hold_by_a_few_milliseconds_splits_nothing() -> None:
    time = np.delete(0.05 * np.arange(400), np.arange(100, 105))  # a step of 0.3 s
    zero = np.zeros(time.size)
    columns = {"time": time, "u": np.sin(time), "x": np.cos(time), "y": zero, "z": zero, "yaw": zero}
    log = Log(Path("loop.csv"), "csv", "0" * 64, {"loop": Table("loop", columns)}, {})

    assert len(flight_of(log, hold=0.295).segments) == 1
    assert len(flight_of(log, hold=0.25).segments) == 2


def test_commands_without_gaps_are_held_for_three_periods_and_nothing_is_said() -> None:
    flight = flight_of(one_table(0, share=0.0))

    assert told(flight) == ""


@pytest.mark.parametrize("name", ["pitch_trn", "pitch_tst", "vert_trn", "vert_tst"])
def test_commands_that_stop_without_a_zero_end_also_where_no_card_says_so(real_flights: Path, name: str) -> None:
    card = replace(load_card("bebop2-optitrack"), hold=None)
    flight = flight_from_log(read(real_flights / "bebop2-optitrack" / f"monster_{name}.bag"), card)

    assert flight.duration == pytest.approx(9.8, abs=0.15)
