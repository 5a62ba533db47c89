"""Results of `rotorfit track` on every recorded flight, as if it were live.

    python bench/bench_track_recorded.py [FOLDER] [--structure S] [--least SECONDS]

FOLDER (default ../../shared/data) contains recorded flights of nine vehicles; those of at least SECONDS (default 9) are
tracked whole. No recording is part of the project; without them nothing is run.

- known: time after the start at which each axis is first `known` [s].
- landing: the last step before landing less the batch fit, in standard errors of the batch fit.
- kept: share of the intervals of the vehicle at 10, 20, 40 s that contain the estimate from the whole flight.
- alarms: every alarm, for inspection.
"""

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np

from bench_real_coverage import VEHICLES, card_of
from rotorfit.app.workflows import load_flight
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.tracked import QUANTITIES, Track
from rotorfit.files.log_span import parse_log
from rotorfit.tracking.replayed import tracked

MOMENTS = (10.0, 20.0, 40.0)


def landing(track: Track) -> list[float]:
    """Of axes and coefficients that both tell: last step less batch, in standard errors."""
    model, last = track.regimes[-1].model, track.states[-2]
    if model is None:
        return []
    return [
        abs(last.axes[axis].values[name] - getattr(one, name)) / one.stderr[name]
        for axis, one in model.axes.items()
        for name in COEFFICIENTS
        if axis in last.axes
        and last.axes[axis].values[name] is not None
        and getattr(one, name) is not None
        and one.stderr.get(name)
    ]


def kept(track: Track) -> dict[float, list[bool]]:
    """Moment to whether each interval then holds what is told at the end."""
    out, end = defaultdict(list), track.states[-1]
    for state in track.states[:-1]:
        for axis, known in state.axes.items() if state.time in MOMENTS else ():
            for name in QUANTITIES:
                low, high = known.ci95.get(name, (None, None))
                value = end.axes[axis].values[name]
                if known.values[name] is not None and value is not None and low is not None and high is not None:
                    out[state.time].append(low <= value <= high)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("folder", nargs="?", type=Path, default=folder)
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--least", type=float, default=9.0)
    given = parser.parse_args()
    logs = dict.fromkeys(str(log).split("@", 1)[0] for vehicle in VEHICLES for log in vehicle.logs)
    off, prophecies, alarms, hours = [], defaultdict(list), 0, 0.0
    for log in logs if given.folder.is_dir() else ():
        where = parse_log(str(given.folder / log))
        flight = load_flight(where, card_of(where.path))
        if flight.duration < given.least:
            continue
        track = tracked(flight, given.structure)
        here, held = landing(track), kept(track)
        off += here
        for moment, each in held.items():
            prophecies[moment] += each
        first = {}
        for state in track.states:
            for axis, known in state.axes.items():
                if known.knowledge == "known":
                    first.setdefault(axis, state.time)
        known = ", ".join(f"{axis} {time:.0f} s" for axis, time in first.items()) or "nothing"
        size = f"off {np.median(here):.2f}, most {max(here):.2f}" if here else "nothing to compare"
        print(f"{log} ({flight.duration:.0f} s): known {known}; {size}", flush=True)
        for alarm in track.alarms:
            print(
                f"  ALARM at {alarm.time:.1f} s: {alarm.cause} {alarm.axes}, since {alarm.since}, p {alarm.p_value:.0e}"
            )
        alarms, hours = alarms + len(track.alarms), hours + flight.duration / 3600
    if off:
        median, most = np.quantile(off, [0.5, 0.99])
        print(f"\nlast step off the batch: {median:.3f} (median), {most:.3f} (99 %) of {len(off)}")
        for moment, each in sorted(prophecies.items()):
            print(f"at {moment:g} s {sum(each)} of {len(each)} intervals hold what the whole flight gives")
        print(f"{alarms} alarms in {60 * hours:.0f} minutes")


if __name__ == "__main__":
    main()
