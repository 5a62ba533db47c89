"""How fast is the virtual flight room, and is its step small enough?

    python bench/bench_simulator.py

One thread. For each vehicle: 60 s with all four axes moving, mocap at 120 Hz with noise, commands at 100 Hz, in calm
air and in gusts, as a batch (simulated seconds per second of processor time, best of several); the time of a call of
`send` and `advance` at 100 Hz; and the change of the path when the step is halved.
"""

import os
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from rotorfit.simulation import rigid_body
from rotorfit.simulation.air import Gusts, Wind
from rotorfit.simulation.flight_room import Conditions, FlightRoom, fly_commands
from rotorfit.simulation.vehicle import builtin_vehicles

DURATION, RUNS, SECOND = 60.0, 7, 1_000_000_000
CALM = Conditions()
GUSTY = Conditions(wind=Wind(mean=(0.5, 0.0, 0.0), gusts=Gusts((0.3, 0.3, 0.1))))


def best_of(work: Callable[[], object]) -> float:
    times = []
    for _ in range(RUNS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def commands() -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0, DURATION, 0.01)
    wave = [
        0.1 * (np.sin(1.3 * t) + np.sin(t)),
        0.1 * (np.cos(1.3 * t) + np.cos(t)),
        0.3 * np.sin(t),
        0.5 * np.sin(0.7 * t),
    ]
    return np.round(t * SECOND).astype(np.int64), np.stack(wave, axis=1)


def main() -> None:
    stamps, sent = commands()
    step = rigid_body.MAX_STEP
    print(f"{'':12}{'calm':>14}{'gusts':>14}{'per call':>12}   halving the step of {step / 1e6:g} ms moves the path by")
    for name, vehicle in builtin_vehicles().items():

        def fly(conditions: Conditions, max_step: int = step, vehicle=vehicle):  # type: ignore[no-untyped-def]
            return fly_commands(vehicle, conditions, stamps, sent, DURATION, 1, (0, 0, 5, 0), max_step)

        def calls(vehicle=vehicle) -> None:  # type: ignore[no-untyped-def]
            room = FlightRoom(vehicle, CALM, 1, (0, 0, 5, 0))
            for k, command in enumerate(sent[:1000].tolist()):
                room.send(command)
                room.advance((k + 1) * SECOND // 100)

        moved = 1e3 * np.abs(fly(CALM).true_position - fly(CALM, step // 2).true_position).max()
        calm, gusty = (DURATION / best_of(lambda c=c: fly(c)) for c in (CALM, GUSTY))  # type: ignore[misc]
        call = best_of(calls) / 1000 * 1e6
        print(f"{name:12}{calm:7.0f} x real{gusty:7.0f} x real{call:9.0f} us   {moved:.1g} mm")


if __name__ == "__main__":
    main()
