"""Coverage of the intervals of the default laws under several true laws: one axis, simulated without rotorfit.

    python bench/bench_laws.py [FLIGHTS] [--truths delay,lag,loop] [--structures averaged,first_order_delay] [--seed N]

FLIGHTS (default 40) flights of 60 s under each true law, by Latin hypercube: a delay alone; a delay and a lag of 0.05
to 0.3 s, both flown on x; and a velocity loop that overshoots (second order with a zero), flown on z. Steps at random
times, coloured wind, pose noise. For each coefficient and combination, and for gain and delay at 1 and 3 rad/s: the
share of 95 % intervals that contain the truth, and their median width over that of the first structure. The simulation
has steps of 2 ms, exact for commands held over them; commands, delays and poses are on that grid. Prints Markdown.
"""

import argparse
from collections import defaultdict

import numpy as np
from scipy.signal import cont2discrete
from scipy.stats import qmc

from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import Interval, Model, Predictor
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import load_card
from sine_response import gain_and_delay, sine_response

STEP = 0.002
DURATION = 60.0
LEAD = 2.0
"""Rest before the first command [s]."""

STRUCTURE = {"delay": "first_order_delay", "lag": "first_order_delay_lag", "loop": "second_order_zero"}
AXIS = {"delay": "x", "lag": "x", "loop": "z"}


def truth_of(kind: str, u: Array) -> Predictor:
    """Numbers of a vehicle, from numbers between 0 and 1."""
    delay = STEP * round((0.02 + 0.18 * u[0]) / STEP)
    if kind == "loop":  # steady gain 0.9 to 1.1, 2.5 to 6 rad/s, damping ratio 0.5 to 0.9, lead 0.1 to 0.4 s
        natural, ratio = 2.5 * 2.4 ** u[1], 0.5 + 0.4 * u[2]
        damping = natural / (2 * ratio)
        return Predictor((0.9 + 0.2 * u[3]) * damping, damping, delay, {
            "lag": 1 / (2 * ratio * natural), "zero": 0.1 + 0.3 * u[4]
        })  # fmt: skip
    damping = 0.2 * 15 ** u[1]
    lag = 0.05 * 6 ** u[2]
    return Predictor(damping * (1 + 2 * u[3]), damping, delay, {"lag": lag} if kind == "lag" else {})


def flown(kind: str, truth: Predictor, u: Array, seed: int) -> Flight:
    """A flight of one axis with the wind, the noise and the pace of steps that u gives."""
    rng, n = np.random.default_rng(seed), round(DURATION / STEP)
    pace, wind, memory, noise = 0.5 * 3 ** u[0], 0.01 * 20 ** u[1], 0.5 * 6 ** u[2], 1e-4 * 20 ** u[3]
    at = np.round((LEAD + np.cumsum(pace * (0.5 + rng.random(round(3 * DURATION / pace))))) / STEP).astype(int)
    at = np.concatenate([[0], at[at < n]])
    command = rng.integers(-1, 2, at.size) * 0.5 / max(truth.input / truth.damping, 0.5)
    command[0] = 0.0
    held = command[np.searchsorted(at, np.arange(n), side="right") - 1]
    late = round(truth.delay / STEP)
    u_late = np.concatenate([np.zeros(late), held[: n - late]])
    gust = np.empty(n)
    gust[0], keep = wind * rng.standard_normal(), np.exp(-STEP / memory)
    kicks = wind * np.sqrt(1 - keep**2) * rng.standard_normal(n)
    for i in range(1, n):
        gust[i] = keep * gust[i - 1] + kicks[i]
    position = _moved(truth, np.column_stack([u_late, gust]), kind)
    picked = np.arange(0, n, round(0.02 / STEP))
    pose, commands = np.zeros((picked.size, 4)), np.zeros((at.size, 4))
    k = AXES.index(AXIS[kind])
    pose[:, k] = position[picked]
    pose[:, :3] += noise * rng.standard_normal((picked.size, 3))
    commands[:, k] = command
    return Flight(
        path=f"{kind} {seed}",
        sha256="0" * 64,
        card=load_card("rotorfit-demo"),
        span=(0.0, DURATION),
        axes=AXES,
        command_time=at * STEP,
        command=commands,
        pose_time=picked * STEP,
        position=np.ascontiguousarray(pose[:, :3]),
        yaw=pose[:, 3].copy(),
        segments=(Segment(0.0, float(picked[-1] * STEP)),),
    )


def _moved(truth: Predictor, inputs: Array, kind: str) -> Array:
    """Positions at the steps, from rest; the wind accelerates."""
    g, b, T, Z = truth.input, truth.damping, truth.extra.get("lag", 1.0), truth.extra.get("zero", 0.0)
    if kind == "delay":
        A, B = [[0, 1, 0], [0, -b, 0], [0, 0, -1]], [[0, 0], [g, 1], [0, 0]]
    elif kind == "lag":
        A, B = [[0, 1, 0], [0, -b, 1], [0, 0, -1 / T]], [[0, 0], [0, 1], [g / T, 0]]
    else:
        A, B = [[0, 1, 0], [0, 0, 1], [0, -b / T, -1 / T]], [[0, 0], [g * Z / T, 0], [g * (1 - Z / T) / T, 1 / T]]
    F, G = cont2discrete((np.array(A, float), np.array(B, float), np.eye(3), np.zeros((3, 2))), STEP)[:2]
    driven, state, out = inputs @ G.T, np.zeros(3), np.empty(len(inputs))
    for i, kick in enumerate(driven):
        out[i] = state[0]
        state = F @ state + kick
    return out


def asked(kind: str, truth: Predictor) -> dict[str, float]:
    """What is true of a vehicle, whatever the law it is fitted with; input, damping and delay by its own law."""
    rest = truth.extra.get("lag", 0.0) if kind == "lag" else 0.0
    out = {
        "steady_gain": truth.input / truth.damping,
        "total_lag": truth.delay + rest + 1 / truth.damping - truth.extra.get("zero", 0.0),
        "input": truth.input, "damping": truth.damping, "delay": truth.delay,
    }  # fmt: skip
    for w in (1.0, 3.0):
        gain, delay = gain_and_delay(STRUCTURE[kind], truth, w)
        out |= {f"gain {w:g}": gain, f"delay {w:g}": delay}
    return out


def told(model: Model, axis: str) -> dict[str, Interval]:
    """Every interval that a model gives."""
    known = model.axes[axis]
    out = dict(known.ci95) | {name: part.ci95 for name, part in known.combinations.items()}
    for w in (1.0, 3.0) if known.predictor else ():
        answer = sine_response(model, axis, w)
        out |= {f"gain {w:g}": answer.gain_ci95, f"delay {w:g}": answer.delay_ci95}
    return out


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("flights", nargs="?", type=int, default=40)
    parser.add_argument("--truths", default="delay,lag,loop")
    parser.add_argument("--structures", default="first_order_delay,averaged")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    structures = options.structures.split(",")
    print("| truth | what | " + " | ".join(f"`{s}` holds, width" for s in structures) + " | of |")
    print("|---|---|" + "---|" * (len(structures) + 1))
    for number, kind in enumerate(options.truths.split(",")):
        held: dict[tuple[str, str], list[bool]] = defaultdict(list)
        width: dict[tuple[str, str], list[float]] = defaultdict(list)
        chosen: dict[str, int] = defaultdict(int)
        for i, u in enumerate(qmc.LatinHypercube(9, seed=1000 * options.seed + number).random(options.flights)):
            truth = truth_of(kind, u[:5])
            flight = flown(kind, truth, u[5:], 100_000 * options.seed + 1000 * number + i)
            for structure in structures:
                model = fit([flight], axes=(AXIS[kind],), structure=structure).model
                known, ends = model.axes[AXIS[kind]], told(model, AXIS[kind])
                for name, true in asked(kind, truth).items():
                    low, high = ends.get(name, (None, None))
                    held[structure, name].append((low is None or low <= true) and (high is None or true <= high))
                    width[structure, name].append(np.inf if low is None or high is None else high - low)
                if structure == "averaged":
                    chosen[" ".join(sorted(law.structure for law in known.laws)) or known.status["input"]] += 1
        for name in (*asked(kind, truth), "all"):
            names = list(asked(kind, truth)) if name == "all" else [name]
            cells = []
            for structure in structures:
                share = np.mean([hit for one in names for hit in held[structure, one]])
                ratio = np.concatenate([np.divide(width[structure, one], width[structures[0], one]) for one in names])
                cells.append(f"{100 * share:.1f} % {np.nanmedian(ratio):.2f}")
            print(f"| {kind} | {name} | " + " | ".join(cells) + f" | {len(names) * options.flights} |", flush=True)
        print(f"| {kind} | laws | {dict(chosen)} |", flush=True)


if __name__ == "__main__":
    main()
