"""Lateness of the commands of a flight in real time, without and with a tracker in parallel.

    python bench/bench_track_beside.py [SECONDS] [ROUNDS]

Flights with 100 commands a second in the virtual flight room in real time, in turn without and with `--track`.
"""

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from flying import SECOND, WallPaced, plan_of, room_link
from rotorfit.app.live.beside import asked_of, tracked_beside
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.recorder import record


def flight(path: Path, seconds: float, wanted: bool) -> str:
    link, plan = WallPaced(room_link()), replace(plan_of(seconds), rate=100.0)
    link.receive(link.now + SECOND // 10)  # compiled before the clock matters
    with tracked_beside(asked_of(plan.card) if wanted else None) as beside:
        link.zero = time.monotonic_ns() - link.link.now
        flown = fly(plan, link, record(path, {}, beside), land=False)
    late = flown.jitter
    told = f"; {beside.words}; {beside.lost} samples lost" if beside else ""
    return f"{1e3 * late.p50:6.3f} ms median, {1e3 * late.p99:6.3f} ms 99 %, {1e3 * late.max:6.2f} ms most{told}"


def main() -> None:
    seconds, rounds = (float(sys.argv[1]) if len(sys.argv) > 1 else 30.0), int((sys.argv[2:] or ["3"])[0])
    with tempfile.TemporaryDirectory() as folder:
        for number in range(2 * rounds):
            wanted = bool(number % 2)
            told = flight(Path(folder, f"{number}.mcap"), seconds, wanted)
            print("with   " if wanted else "without", told, flush=True)


if __name__ == "__main__":
    main()
