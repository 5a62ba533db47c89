"""How late are the states of a live tracker after each sample, and what does it cost?

    python bench/bench_track_live.py [SECONDS] [--structure S] [--here]

A simulated flight in closed loop (see `designs.py`: 120 poses and about 100 commands a second, four axes) is fed to a
live `Tracker` in real time, sample by sample; after each pose the motion is requested.

- filter: compiled Kalman step and driven motion, microseconds per pose, all four axes.
- sample to state: from the instant at which a sample is due until `update` and `motion` have returned; on a busy
  machine that includes the delay in waking the process, so the computing time alone is given, too.
- look to state: from the sample that makes a look due until its state has arrived.
- cost: processor time of this process and of the parallel one, from the first look on, per second of flight.

`--here` makes the looks in this process instead of a parallel one.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np

from designs import designs, flown
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import quaternion_from_yaw
from rotorfit.core.laws import AVERAGED
from rotorfit.core.log import Sample
from rotorfit.tracking.air import courses
from rotorfit.tracking.looks_beside import LooksBeside
from rotorfit.tracking.refits import refitted
from rotorfit.tracking.tracker import Tracker


def samples_of(flight: Flight, seconds: float) -> list[Sample]:
    """Poses and commands in the order of their stamps."""
    rows = np.hstack([flight.position, quaternion_from_yaw(flight.yaw)])
    poses = zip(flight.pose_time, rows.tolist(), strict=True)
    commands = zip(flight.command_time, flight.command.tolist(), strict=True)
    out = [Sample("pose", round(1e9 * t), round(1e9 * t), tuple(values)) for t, values in poses]
    out += [Sample("command", round(1e9 * t), round(1e9 * t), tuple(values)) for t, values in commands]
    return sorted((one for one in out if 0 <= one.stamp < seconds * 1e9), key=lambda one: one.stamp)


def filter_cost(flight: Flight) -> tuple[float, float]:
    """Microseconds a pose of the filters of all axes, and of what is told of them."""
    estimates = {}
    for group in (("x", "y"), ("z",), ("yaw",)):
        estimates |= refitted(flight, group, "first_order_delay", 60.0).estimates
    found = courses(flight, estimates, {})[2]
    commands = flight.command_time, flight.command
    poses = flight.pose_time, flight.position, flight.yaw
    late = flight.pose_time > flight.pose_time[-1] - 30.0
    after = [part[late] for part in poses]
    spent = told = 0.0
    for course in found:
        course.filter.k[:] = 0
        course.filter.clock[:, 0] = after[0][0] - 1e-3
        course.filter.grid[:] = after[0][0], 0.0
        course.filter.k[:] = np.searchsorted(commands[0], after[0][0] - 0.5)
        begun = time.process_time()
        course.filter.follow(*after, *commands)
        spent += time.process_time() - begun
        begun = time.process_time()
        for _ in range(1000):
            course.filter.motion(*commands)
        told += time.process_time() - begun
    return 1e6 * spent / after[0].size, 1e3 * told


def used_by(process: int) -> float:
    """Processor time of a process so far [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seconds", nargs="?", type=float, default=60.0)
    parser.add_argument("--structure", default=AVERAGED)
    parser.add_argument("--here", action="store_true")
    given = parser.parse_args()
    flight = flown(designs(1, True)[0])
    step, told = filter_cost(flight)
    print(f"filter: {step:.2f} us a pose, four axes; what is told of it {told:.1f} us")
    samples = samples_of(flight, given.seconds)
    late, spent, looked = [], [], []
    with Tracker(flight.card, given.structure, origin=0, live=not given.here) as tracker:
        beside = tracker._looks._process.pid if isinstance(tracker._looks, LooksBeside) else None
        time.sleep(0.0 if given.here else 8.0)  # the other process has loaded what it needs
        begun, marked = time.monotonic(), None
        for sample in samples:
            due = begun + sample.stamp / 1e9
            while (left := due - time.monotonic()) > 0:
                time.sleep(left)
            woken = time.monotonic()
            if marked is None and sample.stamp >= 4.9e9:
                marked = time.process_time(), used_by(beside) if beside else 0.0
            tracker.update(sample)
            if sample.stream == "pose":
                tracker.motion()
            now = time.monotonic()
            late.append(now - due)
            spent.append(now - woken)
            looked += [now - begun - state.time for state in tracker.news()]
        own, other = time.process_time() - marked[0], used_by(beside) - marked[1] if beside else 0.0
    length = given.seconds - 4.9
    for name, values in (("sample to state", late), ("of that computing", spent), ("look to state", looked)):
        parts = 1e3 * np.quantile(values, [0.5, 0.99, 0.999, 1.0])
        print(f"{name}: {parts[0]:.2f} ms median, {parts[1]:.2f} 99 %, {parts[2]:.2f} 99.9 %, {parts[3]:.1f} most")
    print(f"within 5 ms: {100 * np.mean(np.array(late) < 5e-3):.2f} % of {len(late)} samples")
    print(f"cost: {100 * own / length:.1f} % of a core feeding, {100 * other / length:.1f} % beside, {given.structure}")


if __name__ == "__main__":
    main()
