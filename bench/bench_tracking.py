"""Does better identification give better flight? Controllers from `ml`, from `paper` and from elsewhere, compared.

    python bench/bench_tracking.py [VEHICLE] [--seeds 20] [--only "NAME;NAME"] [--picture FILE] [--json FILE]

For each seed the vehicle of the virtual flight room first flies the paper's two sines (x with y, z, yaw: the three
training flights of `rotorfit demo`, gusts of 0.2 m/s), and both methods are fitted to them. Then every controller flies
a circle, a lemniscate and steps, in a wind of its seed: a mean of 1 to 2 m/s (Tello: 0.5 to 1) from any horizontal
direction, and Dryden gusts of 0.3, 0.3 and 0.15 m/s. Same seed, same wind, same noise: the comparison is paired.

Printed for each controller: median and quartiles of the errors over the seeds, the share of flights that left the
fence, and the ratio of the error of each to that of the first, as the median over seeds with a 95 % interval by
bootstrap (10,000 resamples, seed 0). Models are kept in `bench/.tracking`, so that a second run is short.

`predictor`, `lqr`, `linearising`   the three designs, each by the same rule of bandwidth
ml, paper                           by the method of the model. `paper` has no delay: by the rule its margins then
                                    hold for that of commercial quadrotors, 0.15 +- 0.10 s
paper at its word                   its delay of 0 and its intervals taken as they are
ml without delay                    the ablation: input and damping of `ml`, without its delay
paper with a guess                  every delay assumed to be exactly 0.15 s
published gains                     feedback linearisation with the gains of drone_dev (KpFL, KdFL), by hand, for the
                                    coefficients of ml and of paper; as published, and with an integral
default PID                         Bebop 2: the gains that drone_dev's configuration calls best under Vicon at 100 Hz
                                    (0.5, 0.5; yaw 1.2, 0.8; integral 0.01). Tello: the defaults of PX4's position loop
                                    (MPC_XY_P 0.95, MPC_Z_P 1.0, MC_YAW_P 2.8) on velocity commands, velocity forward
PID by trial                        the same form, with gains of x and y found by Nelder and Mead in 60 rounds of trial
                                    flights (a round is the three paths in wind of seed 1000): no model
"""

import json
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from rotorfit.app.demo import FLIGHTS
from rotorfit.control.control_law import KINDS, AxisLaw
from rotorfit.control.controller import SHAPES, AxisControllers, ReferencePath
from rotorfit.control.trial import TrackingError, Trial, controller_of, tracking_error, try_path
from rotorfit.control.tuning import LATENCY, RATE, tune
from rotorfit.core.errors import ModelError
from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.logs import read
from rotorfit.files.models import load, save
from rotorfit.files.plans import load_plan, save_plan
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.links.opening import open_link, simulated_at
from rotorfit.flying.mission import attached_to
from rotorfit.flying.preflight import preflight
from rotorfit.flying.recorder import record
from rotorfit.planning.belief import belief_from_card
from rotorfit.planning.plan_flight import plan_flight
from rotorfit.planning.request import space_of_room
from rotorfit.simulation.air import Gusts, Wind
from rotorfit.simulation.flight_room import Conditions
from rotorfit.simulation.vehicle import load_vehicle

ROOM = "6x6x4"
KEPT = Path(__file__).parent / ".tracking"
TRAIN = {name: FLIGHTS[name] for name in ("train_xy", "train_z", "train_yaw")}
PATHS = {
    "bebop2": {"circle": (1.0, 1.0), "lemniscate": (1.2, 1.0), "steps": (1.0, 1.0)},
    "tello": {"circle": (1.0, 0.5), "lemniscate": (1.2, 0.5), "steps": (0.6, 0.5)},
}
"""Size [m] and speed [m/s]."""

DURATION = {"circle": 28.0, "lemniscate": 28.0, "steps": 35.0}
"""The first 5 s are hover and do not count [s]."""

GUESS = 0.15
"""A delay taken from the literature, as sure [s]. Source: mean of `belief.DELAY`."""

MEAN_WIND = {"bebop2": (1.0, 2.0), "tello": (0.5, 1.0)}

LINEARISING = {"x": (1.33, 1.50), "y": (1.40, 1.50), "z": (3.50, 2.00), "yaw": (1.75, 2.00)}
"""Source: jrsbenevides/drone_dev, config/bebopParameters.yaml, KpFL and KdFL."""

DRONE_DEV_PID = {"x": (0.5, 0.5), "y": (0.5, 0.5), "z": (0.5, 0.5), "yaw": (1.2, 0.8)}
"""Source: the same file, Kp and Kd commented as working even better under Vicon at 100 Hz; Ki 0.01."""

PX4 = {"x": 0.95, "y": 0.95, "z": 1.0, "yaw": 2.8}
"""Source: PX4, defaults of MPC_XY_P, MPC_Z_P, MC_YAW_P [1/s]."""


def paths_of(vehicle: str) -> dict[str, ReferencePath]:
    return {shape: ReferencePath(shape, *PATHS[vehicle][shape], DURATION[shape]) for shape in SHAPES}


def conditions_of(vehicle: str, seed: int) -> Conditions:
    rng = np.random.default_rng((2, seed))
    speed, angle = rng.uniform(*MEAN_WIND[vehicle]), rng.uniform(0, 2 * np.pi)
    return Conditions(wind=Wind((speed * np.cos(angle), speed * np.sin(angle), 0.0), Gusts((0.3, 0.3, 0.15))))


def models_of(vehicle: str, seed: int) -> dict[str, Model]:
    """Both methods on the three training flights of a seed."""
    files = {method: KEPT / f"{vehicle}-{seed}-{method}.json" for method in ("ml", "paper")}
    if not all(path.exists() for path in files.values()):
        card, flights = card_from_mapping(load_vehicle(vehicle).card(), vehicle), []
        for number, name in enumerate(TRAIN):
            plan = plan_of(vehicle, name)
            address, own = f"sim:{vehicle},gusts=0.2", 100 * seed + number
            log = KEPT / f"{vehicle}-{seed}-{name}.mcap"
            link = open_link(simulated_at(address, plan.space.start, own), card)
            log.unlink(missing_ok=True)
            fly(plan, link, record(log, attached_to(plan, preflight(plan, link), address)), land=False)
            flights.append(flight_from_log(read(log), card))
            log.unlink()
        for method, path in files.items():
            save(fit(flights, method).model, path)
    return {method: load(path) for method, path in files.items()}


def plan_of(vehicle: str, name: str) -> Plan:
    """A training flight, the same for all seeds."""
    kept = KEPT / f"{vehicle}-{name}.toml"
    if not kept.exists():
        design, axes, duration, amplitude = TRAIN[name]
        card = card_from_mapping(load_vehicle(vehicle).card(), vehicle)
        save_plan(
            plan_flight(
                card, space_of_room(ROOM), design, axes, duration, belief_from_card(card),
                amplitude=amplitude, seed=list(TRAIN).index(name) + 1,
            ), kept,
        )  # fmt: skip
    return load_plan(kept)


def without_delay(model: Model) -> Model:
    """The model as if nothing were known of its delay."""
    names = [name for name in model.covariance_names if not name.endswith(".delay")]
    there = [model.covariance_names.index(name) for name in names]
    axes = {
        axis: replace(known, delay=None, predictor=known.predictor and replace(known.predictor, delay=0.0))
        for axis, known in model.axes.items()
    }
    covariance = model.covariance[np.ix_(there, there)]
    return replace(model, axes=axes, covariance_names=tuple(names), covariance=covariance)


def with_delay(model: Model, delay: float) -> Model:
    """The model as if all its delays were known, without error."""
    bare = without_delay(model)
    axes = {
        axis: replace(known, delay=delay, predictor=known.predictor and replace(known.predictor, delay=delay))
        for axis, known in bare.axes.items()
    }
    names = (*bare.covariance_names, *(f"{axis}.delay" for axis in axes))
    return replace(bare, axes=axes, covariance_names=names, covariance=np.pad(bare.covariance, (0, len(axes))))


def published(model: Model, integral: bool) -> dict[str, AxisLaw]:
    """Feedback linearisation with drone_dev's gains; the integral's pole at a fifth of their frequency."""
    laws = {}
    for axis, known in model.axes.items():
        (p, d), point = LINEARISING[axis], known.predictor
        if point is not None:
            numbers = (1 / RATE, point.input, point.damping, point.delay, LATENCY, p, d)
            laws[axis] = AxisLaw("linearising", *numbers, integral * 0.2 * p**1.5, filter_time=0.03)
    return laws


def pid(gains: Mapping[str, tuple[float, float, float]]) -> dict[str, AxisLaw]:
    """Commands per error."""
    return {
        axis: AxisLaw("pid", 1 / RATE, 1.0, 0.0, 0.0, LATENCY, p, d, i, filter_time=0.03, forward=0.0)
        for axis, (p, d, i) in gains.items()
    }


def default_pid(vehicle: str) -> dict[str, AxisLaw]:
    if vehicle == "bebop2":
        return pid({axis: (p, d, 0.01) for axis, (p, d) in DRONE_DEV_PID.items()})
    scale = dict(zip(AXES, load_vehicle(vehicle).full_scale(), strict=True))
    return {
        axis: AxisLaw("pid", 1 / RATE, scale[axis], 1.0, 0.0, LATENCY, gain, 0.0, filter_time=0.03, forward=0.0)
        for axis, gain in PX4.items()
    }


def pid_by_trial(vehicle: str, rounds: int = 60) -> dict[str, AxisLaw]:
    """The default with other gains of x and y, by trial flights alone."""
    kept = KEPT / f"{vehicle}-pid.json"
    base = default_pid(vehicle)

    def laws(logarithms: Sequence[float]) -> dict[str, AxisLaw]:
        p, d, i = np.exp(logarithms).tolist()
        own = {axis: replace(base[axis], stiffness=p, rate=d, integral=i) for axis in ("x", "y")}
        return {**base, **own}

    def cost(logarithms: Sequence[float]) -> float:
        errors = [
            flown(vehicle, controller_of(laws(logarithms), load_vehicle(vehicle)), 1000, path)[0].position
            for path in paths_of(vehicle).values()
        ]
        return float(np.sqrt(np.mean(np.square(np.minimum(errors, 5.0)))))

    if not kept.exists():
        start = np.log([base["x"].stiffness, max(base["x"].rate, 0.1), 0.1])
        simplex = np.vstack([start, start + 0.5 * np.eye(3)])
        found = minimize(cost, start, method="Nelder-Mead", options={"maxfev": rounds, "initial_simplex": simplex})
        kept.write_text(json.dumps(found.x.tolist()))
    return laws(json.loads(kept.read_text()))


def controllers(vehicle: str, seed: int) -> dict[str, dict[str, AxisLaw]]:
    """Laws by the name of what is compared; a design that a model does not allow is empty."""
    models, out = models_of(vehicle, seed), {}
    for kind in KINDS:
        for method, model in models.items():
            out[f"{kind}, {method}"] = tuned(model, kind)
    out["predictor, ml without delay"] = tuned(without_delay(models["ml"]), "predictor")
    out["linearising, paper at its word"] = tuned(with_delay(models["paper"], 0.0), "linearising")
    out["predictor, paper with a guess"] = tuned(with_delay(models["paper"], GUESS), "predictor")
    if vehicle == "bebop2":
        for method, model in models.items():
            out[f"published gains, {method}"] = published(model, integral=False)
            out[f"published gains and integral, {method}"] = published(model, integral=True)
    return {**out, "default PID": default_pid(vehicle), "PID by trial": pid_by_trial(vehicle)}


def tuned(model: Model, kind: str) -> dict[str, AxisLaw]:
    try:
        return {axis: one.law for axis, one in tune(model, kind).axes.items()}
    except ModelError:
        return {}


def flown(vehicle: str, controller: AxisControllers, seed: int, path: ReferencePath) -> tuple[TrackingError, Trial]:
    trial = try_path(
        controller, load_vehicle(vehicle), conditions_of(vehicle, seed), path, space_of_room(ROOM), 5000 + seed
    )
    return tracking_error(trial), trial


def one_seed(vehicle: str, only: Sequence[str] | None, seed: int) -> dict[str, dict[str, tuple[object, ...]]]:
    """Controller to path to position, heading, overshoot, settling, saturated share."""
    out: dict[str, dict[str, tuple[object, ...]]] = {}
    for name, laws in controllers(vehicle, seed).items():
        if only and name not in only:
            continue
        out[name] = {}
        for shape, path in paths_of(vehicle).items():
            if set(laws) != set(AXES):
                out[name][shape] = (np.inf, np.inf, np.inf, np.inf, 0.0)
                continue
            error, trial = flown(vehicle, controller_of(laws, load_vehicle(vehicle)), seed, path)
            out[name][shape] = (error.position, error.heading, error.overshoot, error.settling, trial.saturated)
    return out


def ratio_interval(ours: np.ndarray, others: np.ndarray) -> tuple[float, float, float]:
    """Median over the seeds of the ratio of two errors, and its 95 % interval by bootstrap over the seeds."""
    ratio, rng = others / ours, np.random.default_rng(0)
    draws = np.median(ratio[rng.integers(0, ratio.size, (10_000, ratio.size))], axis=1)
    low, high = np.quantile(draws, [0.025, 0.975], method="inverted_cdf")
    return float(np.median(ratio)), float(low), float(high)


def show(results: Sequence[Mapping[str, Mapping[str, tuple[float, ...]]]]) -> None:
    names = list(results[0])
    first = names[0]
    for shape in SHAPES:
        print(f"\n{shape}: position [cm], heading [deg], ratio of the position error to that of `{first}`")
        for name in names:
            rows = np.array([[np.nan if v is None else v for v in seed[name][shape]] for seed in results], float)
            own = np.array([seed[first][shape][0] for seed in results])
            low, middle, high = 100 * np.quantile(rows[:, 0], [0.25, 0.5, 0.75], method="inverted_cdf")
            failed = int(np.isinf(rows[:, 0]).sum())
            ratio = ratio_interval(own, rows[:, 0])
            line = f"{name:32} {middle:6.1f} ({low:.1f} to {high:.1f})  {np.degrees(np.median(rows[:, 1])):5.2f}"
            line += f"  x {ratio[0]:.2f} ({ratio[1]:.2f} to {ratio[2]:.2f})"
            if shape == "steps":
                line += f"  overshoot {100 * np.median(rows[:, 2]):3.0f} %  settled in {np.median(rows[:, 3]):.2f} s"
            print(f"{line}  saturated {100 * rows[:, 4].mean():.1f} %  failed {failed} of {len(results)}")


def picture(vehicle: str, file: Path, seed: int) -> None:
    """The circle as flown by the default, by `paper` and by `ml`."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    path, laws = paths_of(vehicle)["circle"], controllers(vehicle, seed)
    shown = {"default PID": "#8a8a8a", "predictor, paper": "#d1662a", "predictor, ml": "#1f6fb4"}
    figure, axes = plt.subplots(1, 3, figsize=(9.0, 3.4), sharex=True, sharey=True, layout="constrained")
    for plot, (name, colour) in zip(axes, shown.items(), strict=True):
        error, trial = flown(vehicle, controller_of(laws[name], load_vehicle(vehicle)), seed, path)
        plot.plot(*trial.reference[:, :2].T, color="black", linewidth=0.8, linestyle="--")
        plot.plot(*trial.pose[:, :2].T, color=colour, linewidth=1.4)
        plot.set_title(f"{name}: {100 * error.position:.1f} cm", fontsize=10)
        plot.set_aspect("equal")
        plot.set_xlabel("x [m]")
    axes[0].set_ylabel("y [m]")
    figure.savefig(file, dpi=90, metadata={"Software": None})


def option(name: str, default: str) -> str:
    return sys.argv[sys.argv.index(name) + 1] if name in sys.argv else default


def main() -> None:
    vehicle = sys.argv[1] if len(sys.argv) > 1 and not sys.argv[1].startswith("-") else "bebop2"
    seeds, only = int(option("--seeds", "20")), [each for each in option("--only", "").split(";") if each]
    KEPT.mkdir(exist_ok=True)
    for name in TRAIN:
        plan_of(vehicle, name)
    with ProcessPoolExecutor(2) as pool:
        first = [pool.submit(pid_by_trial, vehicle), *(pool.submit(models_of, vehicle, 1 + i) for i in range(seeds))]
        for job in first:
            job.result()
        results = []
        for each in pool.map(partial(one_seed, vehicle, only or None), range(1, seeds + 1)):
            results.append(each)
            if kept := option("--json", ""):
                Path(kept).write_text(json.dumps(results))
    show(results)
    if file := option("--picture", ""):
        picture(vehicle, Path(file), 1)


if __name__ == "__main__":
    main()
