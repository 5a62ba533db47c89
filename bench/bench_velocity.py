"""Intervals from the vehicle's own velocity, alone and together with the pose, on flights with known truth.

    python bench/bench_velocity.py [CASE ...] [--flights N]

Each flight lasts 40 s, is open loop, and steps the commands at random about every 0.7 s (set B, 0.15 s delay, the
demo's wind). The velocity is measured forward and left at 20 Hz with a noise of 3 cm/s and a bias of 1 cm/s, 60 ms
late; in the case `rounded` at 10 Hz, without noise, in whole dm/s. The pose is the demo's motion capture (0.5 mm,
120 Hz), or a poor one (5 cm, 20 Hz). Fitted is the law that they obey, `first_order_delay`. Printed: how many 95 %
intervals of the flight contain the truth, bias and scatter of the estimates, and the root mean square of the standard
errors (the interval's width / 3.92); the same for the latency. Seeds 0, 1, 2 ...
"""

import sys
from pathlib import Path

import numpy as np

from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.latency import latency_of
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from flights import steps
from onboard import onboard_card, with_odometry

CASES = ("alone", "rounded", "turning", "beside mocap", "beside a poor pose")
POOR = Truth(mocap_noise=(0.05, 0.05, 0.05, 0.01), pose_rate=20.0, stale_share=0.0)
LATENCY = 0.06

Row = tuple[float, float, float | None, float | None, float | None]
"""Truth, estimate, lower and upper end, standard error."""


def one(case: str, seed: int) -> dict[str, list[Row]]:
    """What one flight gives."""
    truth, lone = POOR if "poor" in case else Truth(), "beside" not in case
    axes = ("x", "y", "yaw") if case == "turning" else ("x",)
    sim = simulate_flight(truth, steps(axes, 0.2, seed=seed), 40.0, seed)
    told = {"rate": 10.0, "noise": 0.0, "rounding": 0.1} if case == "rounded" else {}
    log = with_odometry(sim, latency=LATENCY, **told)
    flight = flight_from_log(log, onboard_card(("x", "y", "z") if lone else (), independent=not lone))
    rows: dict[str, list[Row]] = {}
    fitted = fit([flight], axes=[axis for axis in axes if axis != "yaw"], structure="first_order_delay").model
    for axis, known in fitted.axes.items():
        k, point = AXES.index(axis), known.predictor
        if point is None:
            continue
        true = (*truth.gamma[2 * k : 2 * k + 2], truth.delay[k] + LATENCY * lone)
        for name, value in zip(COEFFICIENTS, true, strict=True):
            low, high = known.ci95_flight[name]
            error = None if low is None or high is None else (high - low) / 3.92
            rows.setdefault(name, []).append((value, getattr(point, name), low, high, error))
    latency = None if lone else latency_of(flight, ("x", "y"))
    if latency is not None and latency.low is not None and latency.high is not None:
        error = (latency.high - latency.low) / 3.92
        rows["latency"] = [(LATENCY, latency.value, latency.low, latency.high, error)]
    return rows


def main() -> None:
    arguments = sys.argv[1:]
    flights = int(arguments.pop(arguments.index("--flights") + 1)) if "--flights" in arguments else 100
    for case in [name for name in arguments if name in CASES] or CASES:
        every = [one(case, seed) for seed in range(flights)]
        for name in (*COEFFICIENTS, "latency"):
            rows = [row for each in every for row in each.get(name, [])]
            if not rows:
                continue
            held = sum((a is None or a <= t) and (b is None or t <= b) for t, _, a, b, _ in rows)
            off = np.array([value - true for true, value, *_ in rows])
            errors = np.array([row[4] for row in rows if row[4] is not None])
            print(
                f"{case:20} {name:8} {held:3} of {len(rows):3}  bias {off.mean():+.5f}  scatter {off.std():.5f}  "
                f"standard error {np.sqrt(np.mean(errors**2)):.5f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
