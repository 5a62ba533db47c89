"""How good is an optimal design: against a bound on every design, random search, coarser steps, and wrong beliefs?

    python bench/bench_optimal.py [AXIS]

The demo's vehicle (set B, delay 0.15 s, light wind, 0.5 mm mocap), axes x and z, 60 s. x: 1.86 m to either side, 1.5
m/s; z: 0.96 m, 1 m/s; commands up to half of full scale. Scores are compared by the factor on the mean standard error
(geometric over input, damping, delay for D, root mean square in units of `optimal.TARGETS` for A). Takes 3 minutes.
The commands are hard steps except in one row, where they are smoothed as in the planner.

The bound. The mean squares of command, position and speed over the N steps cannot exceed those of the limits. With
any weights d >= 0, sum d = 1, the command u of a design inside the limits has u' B u <= 1, where B = sum_i d_i A_i / N
and A_i are the three quadratic forms over their limits squared. With any W > 0

    log det M <= tr(W M) - log det W - 3,   tr(W M) = u' Q_W u <= lambda_max(Q_W, B)

on the commands that end at rest, and scaling W makes the right side 3 log(lambda_max / 3) - log det W. Every W and d
bounds every design; the least bound that Nelder and Mead find is printed.

Source: the relaxation of I. R. Manchester, Input design for system identification via convex relaxation (2010), arXiv
1009.5614, with the limits of all steps summed to three, which makes its dual that small.
"""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import minimize

from rotorfit.core.flight_plan import value
from rotorfit.core.frames import AXES, Array
from rotorfit.planning.axis_information import AxisBelief, AxisInformation, axis_information, extremes, held_states
from rotorfit.planning.belief import Belief, levels_of
from rotorfit.planning.optimal import TARGETS, AxisLimits, Criterion, OptimalSignal, optimal_signal
from rotorfit.planning.plan_flight import fastest
from rotorfit.planning.signals import designed, paper_sines
from rotorfit.simulation.paper_vehicle import Truth

DURATION, STEP = 60.0, 0.1
COARSE = 0.2
"""Step of the bound [s]."""
TRUTH = Truth()
POSE_RATE = TRUTH.pose_rate * (1 - TRUTH.stale_share)
LIMITS = {"x": AxisLimits(0.5, -1.86, 1.86, 1.5), "z": AxisLimits(0.5, -0.96, 0.96, 1.0)}
SCALE = np.outer(TARGETS, TARGETS)
RANDOM = 500
"""Random designs that are tried."""


def dynamics_of(axis: str) -> AxisBelief:
    a = AXES.index(axis)
    return AxisBelief(TRUTH.gamma[2 * a], TRUTH.gamma[2 * a + 1], TRUTH.delay[a])


def levels(dynamics: AxisBelief, axis: str, wind: float = 1.0) -> Array:
    """log of the levels of the demo's wind and mocap at a damping, the wind times a factor."""
    a = AXES.index(axis)
    gamma = list(TRUTH.gamma)
    gamma[2 * a + 1] = dynamics.damping
    belief = Belief(TRUTH, np.zeros((12, 12)), (0.0,) * 4)
    out = np.log(levels_of(belief, Truth(gamma=tuple(gamma)), axis))
    out[0] += 2 * np.log(wind)
    return np.asarray(out)


def design(
    axis: str, criterion: Criterion = "d", step: float = STEP, seed: int = 0, smooth: float = 0.0
) -> OptimalSignal:
    dynamics = dynamics_of(axis)
    return optimal_signal(
        dynamics, levels(dynamics, axis), LIMITS[axis], DURATION, criterion, seed,
        step=step, smooth=smooth, pose_rate=POSE_RATE,
    )  # fmt: skip


def smoothed(axis: str) -> OptimalSignal:
    return design(axis, smooth=2 * np.pi / fastest(Belief(TRUTH, np.zeros((12, 12)), (0.0,) * 4), axis))


def sampled(signal: OptimalSignal, step: float) -> Array:
    return value(signal.signal, step * np.arange(round(DURATION / step)))


def score(information: Array) -> float:
    return float(np.linalg.slogdet(information * SCALE)[1]) / 6


def reach(command: Array, axis: str, step: float, wandering: bool = False) -> float:
    """Largest share of a limit that a command uses; a wandering one may choose where it starts."""
    limits, (low, high, speed) = LIMITS[axis], extremes(dynamics_of(axis), command, step)
    path = (high - low) / (limits.upper - limits.lower) if wandering else max(low / limits.lower, high / limits.upper)
    return max(path, speed / limits.speed, float(np.abs(command).max()) / limits.command)


def bound(form: AxisInformation, axis: str, first: Array) -> float:
    """Least upper bound on the score of any design that is found; `first` is a good design's command."""
    limits, N = LIMITS[axis], first.size
    pulses = [held_states(form.dynamics, row, np.full(N, form.step)) for row in np.eye(N)]
    position, speed = (np.array([pulse[i][1:] for pulse in pulses]).T for i in (0, 1))
    _, _, directions = np.linalg.svd(np.stack([position[-1], speed[-1]]))
    resting = directions[2:].T  # a basis of the commands that end at rest at the start
    uses = [resting / limits.command, position @ resting / limits.upper, speed @ resting / limits.speed]
    use = np.array([each.T @ each / N for each in uses])
    forms = resting.T @ (form.form * SCALE[:, :, None, None]) @ resting
    lower, on = np.tril_indices(3), np.diag_indices(3)

    def value_at(x: Array) -> float:
        share, root = np.exp(x[:3] - x[:3].max()), np.zeros((3, 3))
        root[lower] = x[3:]
        root[on] = np.exp(root[on])
        weighted, limit = np.tensordot(root @ root.T, forms, 2), np.tensordot(share / share.sum(), use, 1)
        largest = eigh(weighted, limit, eigvals_only=True, subset_by_index=[N - 3, N - 3])[0]
        return float(3 * np.log(largest / 3) - 2 * np.log(root[on]).sum()) / 6

    root = np.linalg.cholesky(np.linalg.inv(form.information(first) * SCALE))
    root[on] = np.log(root[on])
    x = np.concatenate([np.zeros(3), root[lower]])
    for size in (1.5, 0.5, 0.2):
        simplex = np.concatenate([x[None], x + size * np.eye(9)])
        x = minimize(value_at, x, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": 350}).x
    return value_at(x)


def random_search(form: AxisInformation, axis: str) -> float:
    """Best score of random binary commands of any pace, made as large as fits; their start may be anywhere."""
    rng, best = np.random.default_rng(0), -np.inf
    for _ in range(RANDOM):
        dwell = np.exp(rng.uniform(np.log(0.1), np.log(6.0)))
        switch = np.cumsum(rng.exponential(dwell, int(2 * DURATION / dwell) + 10))
        sign = 1.0 - 2.0 * (np.searchsorted(switch, form.step * np.arange(form.form.shape[-1])) % 2)
        best = max(best, score(form.information(sign / reach(sign, axis, form.step, wandering=True))))
    return best


def classic(form: AxisInformation, axis: str) -> dict[str, float]:
    """Scores of the other designs in open loop, made as large as fits; their start may be anywhere."""
    t = form.step * (np.arange(form.form.shape[-1]) + 0.5)
    signals = {
        name: designed(name, 1.0, DURATION, (0.6, 6.0)) for name in ("multisine", "chirp", "doublets", "3211", "prbs")
    }
    commands = {name: value(signal, t) for name, signal in {"two_sines": paper_sines(axis), **signals}.items()}
    return {
        name: score(form.information(u / reach(u, axis, form.step, wandering=True))) for name, u in commands.items()
    }


def wrong_beliefs(axis: str) -> dict[str, tuple[float, float]]:
    """Factors by which a design for a wrong belief is worse than one for the truth: as it is, and made to fit.

    As it is, its path may leave the room; to fit, it shrinks, in open loop, and may start anywhere.
    """
    right, out = dynamics_of(axis), {}
    form = axis_information(right, levels(right, axis), DURATION, STEP, POSE_RATE)

    def scores(dynamics: AxisBelief, wind: float) -> Array:
        found = optimal_signal(dynamics, levels(dynamics, axis, wind), LIMITS[axis], DURATION, pose_rate=POSE_RATE)
        command = sampled(found, STEP)
        shrink = max(1.0, reach(command, axis, STEP, wandering=True))
        return np.array([score(form.information(command)), score(form.information(command / shrink))])

    best = scores(right, 1.0)
    cases = {
        "half the damping": (right._replace(damping=right.damping / 2), 1.0),
        "twice the damping": (right._replace(damping=right.damping * 2), 1.0),
        "a delay of 0.05 s": (right._replace(delay=0.05), 1.0),
        "a delay of 0.30 s": (right._replace(delay=0.3), 1.0),
        "0.8 of the input": (right._replace(gain=0.8 * right.gain), 1.0),
        "a fifth of the wind": (right, 0.2),
        "five times the wind": (right, 5.0),
    }
    for name, case in cases.items():
        bare, fitting = np.exp(best - scores(*case))
        out[name] = float(bare), float(fitting)
    return out


def timed(work: Callable[[], OptimalSignal]) -> tuple[OptimalSignal, float]:
    start = time.perf_counter()
    return work(), time.perf_counter() - start


def main() -> None:
    path = Path(__file__).with_name("optimal.json")
    result: dict[str, object] = json.loads(path.read_text()) if path.exists() else {}
    for axis in sys.argv[1:] or LIMITS:
        dynamics = dynamics_of(axis)
        form = axis_information(dynamics, levels(dynamics, axis), DURATION, STEP, POSE_RATE)
        best, seconds = timed(lambda axis=axis: design(axis))
        own = score(form.information(sampled(best, STEP)))
        worst = float(np.exp(own - min(best.scores)))
        print(f"\n{axis}: D, {seconds:.1f} s, gap {best.gap:.1e}, local optima worse by up to {worst:.3f}")
        coarse = design(axis, step=COARSE)
        coarse_form = axis_information(dynamics, levels(dynamics, axis), DURATION, COARSE, POSE_RATE)
        top = bound(coarse_form, axis, sampled(coarse, COARSE))
        rows = {
            "bound on every design (steps of 0.2 s), at least": coarse.score - top,
            "optimal, steps of 0.2 s": own - coarse.score,
            "optimal, smoothed": own - score(form.information(sampled(smoothed(axis), STEP))),
            "another seed": own - design(axis, seed=1).score,
            f"best of {RANDOM} random binary signals": own - random_search(form, axis),
            **{name: own - each for name, each in classic(form, axis).items()},
        }  # fmt: skip
        factors = {name: float(np.exp(each)) for name, each in rows.items()}
        a = design(axis, "a")
        errors = {"d": best.errors, "a": a.errors}
        wrong = wrong_beliefs(axis)
        for name, factor in factors.items():
            print(f"  {name:52}{factor:7.3f}")
        print("  designed for another vehicle: as it is, and made to fit")
        for name, (bare, fitting) in wrong.items():
            print(f"  {name:52}{bare:7.3f}{fitting:7.3f}")
        print("  standard errors (input, damping: shares; delay: s): " + ", ".join(
            f"{criterion} " + " ".join(f"{each:.2g}" for each in told) for criterion, told in errors.items()
        ))  # fmt: skip
        result[axis] = {"gap": best.gap, "factors": factors, "wrong": wrong, "errors": errors}
        path.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")


if __name__ == "__main__":
    main()
