"""How well does `rotorfit track` estimate the wind? Flights in gusts, compared with a filter that knows the vehicle.

    python bench/bench_track_wind.py [FLIGHTS] [--gusts 1,2] [--first SEED] [--structure S]

FLIGHTS (default 4) of 90 s for each of gusts of 1 to 5 m/s (Dryden) with a mean wind of 3 m/s, a Bebop 2 in closed loop
(tilts: its damping is drag).

- ratio: RMS error, from 30 s on, of the acceleration of x and y due to the air, over that of the same filter at the
  vehicle's true input, damping and delay, with levels and trim fitted there.
- held: share of the 95 % intervals that contain that acceleration, and the same of that filter's intervals.
- bound: the ratio of an estimator that errs as little as the Cramer-Rao bound of the flight so far allows, at the true
  coefficients and without a prior; and the bound of the damping, median, the bound of the mean wind's speed too.
- mean wind: errors of speed and direction over all seconds from 30 s on, median and 90 %, and the share of intervals
  that contain the mean of the wind over the same time.
"""

import argparse
from dataclasses import replace

import numpy as np

from changing_flights import ChangingFlight, Scenario, changing_flight
from rotorfit.core.frames import AXES, heading_from_world
from rotorfit.core.model import NORMAL
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.estimand import estimands
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.tracking.air import AVERAGED, LOOKS_BACK, courses, doubts_of
from rotorfit.tracking.following import Following
from rotorfit.tracking.replayed import growing

SETTLED = 30.0
HELD, BOUND = ("held", "informed held"), ("bound", "damping")


def informed(estimate: Estimate, flown: ChangingFlight, axis: str) -> Estimate:
    """The estimate at the vehicle's true coefficients: trims, start velocities and levels fitted."""
    truth, point, places = flown.linear[0], estimate.optimum.point, {"x": 0, "y": 1}
    K = point.gain.size
    gain, log_damping, delay = point.gain.copy(), point.log_damping.copy(), point.delay.copy()
    for name, k in places.items() if K == 2 else ((axis, 0),):
        i = AXES.index(name)
        gain[k], log_damping[k], delay[k] = truth.gamma[2 * i], np.log(truth.gamma[2 * i + 1]), truth.delay[i]
    free = estimate.optimum.free.copy()
    free[: point.coefficients] = False
    there = replace(point, gain=gain, log_damping=log_damping, delay=delay)
    return replace(estimate, optimum=replace(maximise(estimate.records, there, free), free=estimate.optimum.free))


def errors(flown: ChangingFlight, structure: str) -> list[dict[str, float]]:
    """Errors of every second from `SETTLED` on."""
    following, flight, out = Following(structure), flown.flight, []
    damping = np.array(flown.linear[0].gamma[1:4:2])
    for part, now in growing(flight, following.next_look):
        state = following.look(part, now)
        if now < SETTLED:
            continue
        n = part.pose_time.size
        row: dict[str, float] = {}
        out.append(row)
        if state.air:
            back = min(now - part.segments[-1].start, LOOKS_BACK) - AVERAGED / 2
            mean = flown.wind[:n][part.pose_time > now - back, :2].mean(axis=0)
            turned = (state.air.direction - np.arctan2(mean[1], mean[0]) + np.pi) % (2 * np.pi) - np.pi
            low, high = state.air.speed_ci95
            row |= {"speed": state.air.speed - np.hypot(*mean), "direction": np.degrees(turned)}
            row["speed held"] = low <= np.hypot(*mean) <= high
        if any(state.axes[axis].wind is None for axis in "xy"):
            continue
        true = damping * heading_from_world(flown.wind[n - 1 : n, :2], part.yaw[-1:])[0]
        estimates = {}
        for group in following.learnt.groups.values():
            estimates |= group.fitted.estimates if group.fitted else {}
        exact = {axis: informed(estimates[axis], flown, axis) for axis in "xy"}
        known = courses(part, exact, {})[0]
        bounds = doubts_of(part, exact, {axis: {} for axis in exact}, known)
        for k, axis in enumerate("xy"):
            low, high = state.axes[axis].wind_ci95
            row[f"{axis} error"] = state.axes[axis].wind - true[k]
            row[f"{axis} informed"] = known[axis].wind - true[k]
            row[f"{axis} informed held"] = abs(known[axis].wind - true[k]) <= NORMAL * known[axis].wind_error
            row[f"{axis} bound"] = bounds[axis].wind
            row[f"{axis} damping"] = estimands(exact[axis].optimum, exact[axis].place)["damping"].error(
                exact[axis].optimum
            )
            row[f"{axis} held"] = low <= true[k] <= high
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flights", nargs="?", type=int, default=4)
    parser.add_argument("--gusts", default="1,2,3,4,5")
    parser.add_argument("--first", type=int, default=900)
    parser.add_argument("--structure", default="first_order_delay")
    given = parser.parse_args()
    for gusts in [float(one) for one in given.gusts.split(",")]:
        rows = []
        for seed in range(given.flights):
            scenario = Scenario("none", "bebop2", "closed", gusts, mean=3.0, duration=90.0)
            rows += errors(changing_flight(given.first + seed, scenario), given.structure)
        mean = f"mean wind told in {sum('speed' in row for row in rows)} of {len(rows)} s"
        speed, turned = (np.abs([row[what] for row in rows if what in row]) for what in ("speed", "direction"))
        if speed.size:
            held = np.mean([row["speed held"] for row in rows if "speed held" in row])
            mean += f", off by {np.median(speed):.2f} ({np.quantile(speed, 0.9):.2f}) m/s"
            mean += f", {np.median(turned):.0f} ({np.quantile(turned, 0.9):.0f}) deg, held {100 * held:.0f} %"
        if told := [row for row in rows if "x held" in row]:
            pairs = (np.array([[row[f"{a} {what}"] for a in "xy"] for row in told]) for what in ("error", "informed"))
            ours, known = (float(np.sqrt(np.mean(each**2))) for each in pairs)
            held, theirs = (np.mean([[row[f"{a} {what}"] for a in "xy"] for row in told]) for what in HELD)
            least, damping = (np.array([[row[f"{a} {what}"] for a in "xy"] for row in told]) for what in BOUND)
            pushed = f"RMS {ours:.3f} against {known:.3f} m/s^2, ratio {ours / known:.2f}"
            pushed += f" (bound {np.sqrt(1 + np.mean(least**2) / known**2):.2f})"
            pushed += f"; held {100 * held:.0f} % (knowing {100 * theirs:.0f} %)"
            mean += f"; damping's bound {100 * np.median(damping):.0f} %"
        else:
            pushed = "the acceleration is never told"
        print(f"gusts {gusts:g} m/s: {pushed} of {2 * len(told)}; {mean}", flush=True)


if __name__ == "__main__":
    main()
