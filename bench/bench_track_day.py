"""A day of flight through a whole `Tracker`: memory, time of a look, and false alarms, in stretches of ten minutes.

    python bench/bench_track_day.py [HOURS] [--rate HZ] [--structure S]

A vehicle under the first-order law on four axes in gusty wind, with 20 poses and 10 commands a second: few, so that a
day takes hours and not a week; looks come once a second as usual. It is alternately flown for eight minutes, hovers for
one under constant commands, and gets no commands for one. Nothing in it changes: every alarm is a false one.

- memory: memory of the process [MB]; should be constant once 900 s are remembered.
- look: processor time of a look without refits, mean over ten minutes [ms]; should be constant once looks reach back
  over 300 s.
- refits: number of refits and their total processor time [s].
"""

import argparse
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numba
import numpy as np

import rotorfit.tracking.change_watch as change_watch_module
import rotorfit.tracking.following as following_module
from rotorfit.core.log import Sample
from rotorfit.files.cards import load_card
from rotorfit.tracking.tracker import Tracker

TURN, FLOWN, HELD = 600.0, 480.0, 540.0
"""Length of a turn, until when of it commands change, and until when there are any [s]."""

GAIN, DAMPING, DELAY = np.array([3.6, 3.6, 2.5, 3.0]), np.array([0.3, 0.3, 1.5, 2.0]), np.array([0.15, 0.15, 0.1, 0.08])
TRIM, GUST, MEMORY, NOISE = np.array([0.05, -0.04, 0.02, 0.01]), 0.15, 1.5, 5e-4
AMPLITUDE = np.array([0.2, 0.2, 0.4, 0.4])
STEPS = 10
"""Of the integration between two poses."""


@numba.njit
def moved(state: np.ndarray, command: np.ndarray, noise: np.ndarray, dt: float) -> np.ndarray:  # type: ignore[type-arg]
    """Positions after each pose: state holds position, velocity and gust of each axis, shape (4, 3)."""
    out = np.empty((command.shape[0] // STEPS, 4))
    fade, rise = np.exp(-dt / MEMORY), GUST * np.sqrt(1 - np.exp(-2 * dt / MEMORY))
    for i in range(command.shape[0]):
        c, s = np.cos(state[3, 0]), np.sin(state[3, 0])
        vx, vy = state[0, 1], state[1, 1]
        velocity = (c * vx + s * vy, c * vy - s * vx, state[2, 1], state[3, 1])  # of x and y along the heading
        for a in range(4):
            state[a, 0] += dt * state[a, 1]
        ax = GAIN[0] * command[i, 0] + TRIM[0] - DAMPING[0] * velocity[0]
        ay = GAIN[1] * command[i, 1] + TRIM[1] - DAMPING[1] * velocity[1]
        state[0, 1] += dt * (c * ax - s * ay + state[0, 2])
        state[1, 1] += dt * (s * ax + c * ay + state[1, 2])
        for a in range(2, 4):
            state[a, 1] += dt * (GAIN[a] * command[i, a] + TRIM[a] + state[a, 2] - DAMPING[a] * velocity[a])
        for a in range(4):
            state[a, 2] = fade * state[a, 2] + rise * noise[i, a]
        if (i + 1) % STEPS == 0:
            out[i // STEPS] = state[:, 0]
    return out


def samples(hours: float, rate: float, seed: int = 1) -> Iterator[Sample]:
    """The day, in order."""
    rng, state = np.random.default_rng(seed), np.zeros((4, 3))
    count, dt = int(TURN * rate), 1 / rate / STEPS
    fine = (np.arange(count * STEPS) + 0.5) * dt
    for turn in range(round(hours * 3600 / TURN)):
        sent = np.arange(0, HELD, 2 / rate)
        levels = AMPLITUDE * rng.integers(-1, 2, (int(TURN), 4))
        wanted = levels[np.minimum(sent, FLOWN).astype(int)]
        acting = [np.searchsorted(sent + delay, fine, side="right") - 1 for delay in DELAY]
        command = np.column_stack([np.where(k >= 0, wanted[np.maximum(k, 0), a], 0.0) for a, k in enumerate(acting)])
        command[fine > HELD + 1.0] = 0.0
        pose = moved(state, command, rng.standard_normal((fine.size, 4)), dt) + NOISE * rng.standard_normal((count, 4))
        times = turn * TURN + (np.arange(count) + 1) / rate
        poses = [
            (t, "pose", (*p[:3], np.cos(p[3] / 2), 0.0, 0.0, np.sin(p[3] / 2)))
            for t, p in zip(times, pose, strict=True)
        ]
        out = poses + [(turn * TURN + t, "command", tuple(u)) for t, u in zip(sent, wanted, strict=True)]
        for t, stream, values in sorted(out, key=lambda one: one[0]):
            stamp = round(t * 1e9)
            yield Sample(stream, stamp, stamp, tuple(map(float, values)))


def memory() -> float:
    """Of this process now [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("hours", nargs="?", type=float, default=24.0)
    parser.add_argument("--rate", type=float, default=20.0)
    parser.add_argument("--structure", default="first_order_delay")
    given = parser.parse_args()
    spent, refits, refit = [], [], following_module.refitted

    def timed(*words, **named):  # type: ignore[no-untyped-def]
        begun = time.process_time()
        found = refit(*words, **named)
        refits.append(time.process_time() - begun)
        return found

    following_module.refitted = change_watch_module.refitted = timed
    tracker, alarms, due = Tracker(load_card("rotorfit-demo"), given.structure, origin=0), 0, TURN
    print("hours  memory MB  look ms  most ms  refits  their s  alarms  x: input  interval  state", flush=True)
    for sample in samples(given.hours, given.rate):
        begun, before = time.process_time(), sum(refits)
        tracker.update(sample)
        took = time.process_time() - begun
        for state in tracker.news():
            spent.append(took - (sum(refits) - before))
            alarms += len(state.alarms)
        if sample.stamp >= due * 1e9:
            one = tracker.state().axes["x"]
            low, high = one.ci95.get("input", (None, None))
            value = one.values["input"] or np.nan
            print(
                f"{due / 3600:5.2f}  {memory():9.1f}  {1e3 * np.mean(spent):7.1f}  {1e3 * np.max(spent):7.1f}  "
                f"{len(refits):6d}  {sum(refits):7.1f}  {alarms:6d}  {value:8.3f}  "
                f"{low or np.nan:.2f} to {high or np.nan:.2f}  {one.state}",
                flush=True,
            )
            spent, due = [], due + TURN
            refits.clear()
    print(f"{given.hours:g} h of flight: {alarms} false alarms")


if __name__ == "__main__":
    main()
