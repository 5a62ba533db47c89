"""Do the intervals of `rotorfit track` contain, at every moment, the measured response of a real autopilot?

    python bench/bench_track_autopilot.py [FOLDER] [--structure S]

FOLDER (default ../../shared/data/arducopter-sitl) contains flights of ArduCopter in software and its true response,
measured by sines and steps without rotorfit (see `bench_autopilot.py`): none of our laws is exact there. Steady gain
and total lag of all axes, 10, 20, 40 and 59 s after the start, with the error of the truth; and the number of alarms.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import rotorfit as rf
from bench_autopilot import GAIN_ERROR, SLOW_ERROR, SMALL, truth_of
from rotorfit.tracking.following import Following
from rotorfit.tracking.replayed import growing

MOMENTS = (10.0, 20.0, 40.0, 59.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    folder = Path(__file__).resolve().parents[2] / "shared" / "data" / "arducopter-sitl"
    parser.add_argument("folder", nargs="?", type=Path, default=folder)
    parser.add_argument("--structure", default="averaged")
    given = parser.parse_args()
    truth, held, alarms = truth_of(given.folder), defaultdict(list), 0
    for name in SMALL:
        flight, following = rf.flight(given.folder / f"{name}.mcap"), Following(given.structure)
        for part, now in growing(flight, following.next_look):
            state = following.look(part, now)
            alarms += len(state.alarms)
            for axis, known in state.axes.items() if now in MOMENTS else ():
                for what, error in (("steady_gain", GAIN_ERROR), ("total_lag", SLOW_ERROR)):
                    for kind, ends in (("vehicle", known.ci95), ("this flight", known.ci95_flight)):
                        low, high = ends.get(what, (None, None))
                        if low is not None and high is not None:
                            held[now, what, kind].append(low - error <= truth[axis][what] <= high + error)
    for (now, what, kind), found in sorted(held.items()):
        print(f"{now:4.0f} s  {what:11}  {kind:11}  {sum(found):3} of {len(found)}")
    print(f"{alarms} alarms")


if __name__ == "__main__":
    main()
