"""Accuracy of live estimation: recursive estimators compared with rotorfit, on the same flights.

    python bench/bench_track_peers.py [FLIGHTS] [--jobs N] [--recorded]

FLIGHTS (default 10) of 60 s in open loop and as many in closed loop (see `designs.py`). z and yaw are scored, since x
and y would require a model of the heading of every peer, at 10, 20, 40 and 60 s: the median error in Cramer-Rao bounds
of the flight so far, and the share of 95 % intervals that contain the truth, where there are any. `--recorded`: two
recorded flights, with the batch fit of the whole flight as truth and its standard error as bound.

Peers, each in its plain published form and with help that rotorfit does not get:

- `rls`: recursive least squares of v+ = a v + beta u + c at 10 Hz, forgetting within 20 s; given the true delay.
- `sift`: the same, forgetting only along the regressor (SIFt-RLS: B. Lai, D. S. Bernstein, arXiv 2404.10844; of one
  measurement a step, information filter 1e-3 of the mean square).
- `ekf`: extended Kalman filter of position, velocity, log g, log b, wind and trim at every pose; given the true delay
  and the true strengths of wind and noise.
- `paper`: the paper's regression over the last 20 s; without a delay.
- `xcorr`: the delay at the peak of the masked normalised cross-correlation of command and measured acceleration (D.
  Padfield, IEEE Trans. Image Process. 21 (2012), as openpilot's lagd), parabola at the peak; up to 0.5 s.
- `track`: rotorfit, under the law that these vehicles obey; the delay is estimated, too.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from designs import Design, bounds, designs, flown, truth_of
from peers.flights import REAL_FLIGHTS, recorded
from rotorfit.core.errors import RotorfitError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.optima import between
from rotorfit.tracking.following import Following
from rotorfit.tracking.replayed import growing

MOMENTS = (10.0, 20.0, 40.0, 60.0)
LAW = "first_order_delay"
GRID, COARSE = 30.0, 10.0
"""Samples a second: of derivatives; of the recursive regressions."""
MEMORY = 20.0
"""Of what forgets, and of the moving window [s]."""
LONGEST_DELAY = 0.5
NORMAL = 1.96

Told = dict[str, tuple[float, float | None, float | None]]
"""Name of a coefficient to estimate and ends of the 95 % interval; None where a method gives none."""

RECORDED = {"bebop2-wsu X": ("bebop2-wsu/Training_CT_TestDay_X.mat", "x"),
            "bebop2-wsu Z": ("bebop2-wsu/Training_CT_TestDay_Z.mat", "z")}  # fmt: skip


@dataclass(frozen=True)
class Signal:
    """One axis in the heading that is held, up to a moment.

    Attributes:
        time: At `GRID`, shape (N,) [s].
        position: Of the axis, shape (N,) [m, rad].
        command_time: Shape (M,) [s].
        command: Held until the next, shape (M,).
    """

    time: Array
    position: Array
    command_time: Array
    command: Array

    def held(self, time: Array) -> Array:
        """The command in force."""
        at = np.searchsorted(self.command_time, time, side="right") - 1
        return np.where(at >= 0, self.command[np.maximum(at, 0)], 0.0)

    def mean(self, time: Array, step: Array | float) -> Array:
        """The command's mean over each step from these times on."""
        fine = np.broadcast_to(step, time.shape)[:, None] * (np.arange(16) + 0.5) / 16
        return self.held(time[:, None] + fine).mean(axis=1)

    def derivative(self, order: int) -> Array:
        return np.asarray(savgol_filter(self.position, 9, 3, deriv=order, delta=1 / GRID))


def signal_of(flight: Flight, axis: str, resampled: bool = True) -> Signal:
    """One axis at `GRID`, or at the poses themselves."""
    time = flight.pose_time[flight.pose_time >= flight.command_time[0]]
    if resampled:
        time = np.arange(time[0], time[-1], 1 / GRID)
    pose = flight.yaw
    if axis != "yaw":
        pose = flight.position[:, AXES.index(axis)]
        if axis in ("x", "y"):
            psi = float(np.mean(flight.yaw))
            x, y = flight.position[:, 0], flight.position[:, 1]
            pose = np.cos(psi) * x + np.sin(psi) * y if axis == "x" else np.cos(psi) * y - np.sin(psi) * x
    seen = np.interp(time, flight.pose_time, pose)
    return Signal(time, seen, flight.command_time, flight.command[:, AXES.index(axis)])


# The peers


def least_squares(signal: Signal, delay: float, directional: bool) -> Told:
    """Recursive least squares with forgetting; information and not covariance, so that both forms are one line."""
    step = round(GRID / COARSE)
    time, v = signal.time[::step], signal.derivative(1)[::step]
    h = step / GRID
    u = signal.mean(time - delay, h)
    rows = np.column_stack([v, u, np.ones(v.size)])[:-1]
    scale = np.sqrt(np.mean(rows**2, axis=0)) + 1e-12
    rows, answer, keep = rows / scale, v[1:], np.exp(-h / MEMORY)
    R, theta, squares, weight = 1e-3 * np.eye(3), np.zeros(3), 0.0, 0.0
    for phi, y in zip(rows, answer, strict=True):
        if directional:
            if phi @ phi < 1e-3 * 3:
                continue  # filtered: nothing comes in, nothing is forgotten
            along = R @ phi
            R = R - (1 - keep) * np.outer(along, along) / (phi @ along)
        else:
            R = keep * R
        R = R + np.outer(phi, phi)
        off = y - phi @ theta
        theta = theta + np.linalg.solve(R, phi) * off
        squares, weight = keep * squares + off**2, keep * weight + 1
    covariance = np.linalg.inv(R) * squares / max(weight - 3, 1) / np.outer(scale, scale)
    a, beta, _ = theta / scale
    if not 0 < a < 1:
        return {}
    b = -np.log(a) / h
    g = beta * b / (1 - a)
    by_a = beta * (-1 / (a * h) / (1 - a) + b / (1 - a) ** 2)
    g_error = np.sqrt(np.array([by_a, b / (1 - a)]) @ covariance[:2, :2] @ np.array([by_a, b / (1 - a)]))
    b_error = np.sqrt(covariance[0, 0]) / (a * h)
    return {"input": _around(g, g_error), "damping": _around(b, b_error)}


def kalman(signal: Signal, delay: float, wind: tuple[float, float], noise: float) -> Told:
    """Extended Kalman filter with augmented states; wind is a first-order process of (sigma, time) and a constant."""
    steps = np.append(np.diff(signal.time), 1 / GRID)
    u = signal.mean(signal.time - delay, steps)
    x = np.array([signal.position[0], 0.0, np.log(2.0), np.log(1.0), 0.0, 0.0])
    P = np.diag([noise**2, 0.25, 1.0, 1.0, wind[0] ** 2, 0.01])
    H = np.eye(6)[0]
    for k, (z, h) in enumerate(zip(signal.position, steps, strict=True)):
        fade = np.exp(-h / wind[1])
        K = P @ H / (P[0, 0] + noise**2)
        x = x + K * (z - x[0])
        P = P - np.outer(K, H @ P)
        g, b = np.exp(np.clip(x[2:4], -6.0, 4.0))
        e = np.exp(-b * h)
        push, lasts = g * u[k] + x[4] + x[5], (1 - e) / b
        v = e * x[1] + lasts * push
        by_b = -h * e * x[1] + (h * e * b - (1 - e)) / b**2 * push
        F = np.eye(6)
        F[0, 1] = h
        F[0, 2:] = 0.5 * h * h * np.array([g * u[k], -b * x[1], 1.0, 1.0])
        F[1] = [0.0, e, lasts * g * u[k], by_b * b, lasts, lasts]
        F[4, 4] = fade
        x = np.array([x[0] + 0.5 * h * (x[1] + v), v, x[2], x[3], fade * x[4], x[5]])
        P = F @ P @ F.T
        P[4, 4] += wind[0] ** 2 * (1 - fade**2)
    out: Told = {}
    for name, k in (("input", 2), ("damping", 3)):
        error = NORMAL * np.sqrt(max(P[k, k], 0.0))
        out[name] = tuple(float(np.exp(np.clip(end, -20, 20))) for end in (x[k], x[k] - error, x[k] + error))  # type: ignore[assignment]
    return out


def correlation(signal: Signal) -> Told:
    """The delay by masked normalised cross-correlation; the mask leaves out where the command has not yet begun."""
    u, a = signal.held(signal.time), signal.derivative(2)
    lags = np.arange(round(LONGEST_DELAY * GRID) + 1)
    value = np.zeros(lags.size)
    for lag in lags:
        one, other = u[: u.size - lag], a[lag:]
        one, other = one - one.mean(), other - other.mean()
        value[lag] = one @ other / max(np.sqrt((one @ one) * (other @ other)), 1e-12)
    best = int(np.argmax(value))
    if not 0 < best < lags.size - 1:
        return {"delay": (best / GRID, None, None)}
    left, top, right = value[best - 1 : best + 2]
    return {"delay": ((best + 0.5 * (left - right) / (left - 2 * top + right)) / GRID, None, None)}


def by_paper(flight: Flight, now: float) -> Mapping[str, Told]:
    """The paper's regression over the window."""
    try:
        model = fit([between(flight, max(now - MEMORY, 0.0), now)], method="paper").model
    except RotorfitError:
        return {}
    return {
        axis: {
            name: (getattr(one, name), *one.ci95.get(name, (None, None)))
            for name in ("input", "damping")
            if getattr(one, name) is not None
        }
        for axis, one in model.axes.items()
    }


def _around(value: float, error: float) -> tuple[float, float, float]:
    return float(value), float(value - NORMAL * error), float(value + NORMAL * error)


# Scores


Score = tuple[str, str, float, float, bool | None]
"""Method, coefficient, moment, error in bounds, whether the interval held the truth."""


def scored(method: str, told: Told, now: float, truth: Array, bound: Array, wanted: Sequence[str]) -> list[Score]:
    """The errors of what one method told of one axis; of what it did not tell there is none."""
    out = []
    for name, true, error in zip(COEFFICIENTS, truth, bound, strict=True):
        if name in told and name in wanted and np.isfinite(true):
            value, low, high = told[name]
            held = (
                None
                if low is None and high is None
                else (low is None or low <= true) and (high is None or true <= high)
            )
            out.append((method, name, now, abs(value - true) / error, held))
    return out


def looked_at(
    flight: Flight, axes: Sequence[str], truths: Callable[[Flight], Mapping[str, tuple[Array, Array]]],
    help_of: Callable[[str], tuple[float, tuple[float, float], float]], moments: Sequence[float],
) -> list[Score]:  # fmt: skip
    """All methods on one flight, on the coefficients that rotorfit tells at each moment.

    Args:
        flight: Whole.
        axes: To score.
        truths: Of the flight so far, axis to truth and bound.
        help_of: Axis to delay, wind (sigma, time) and noise that peers are told.
        moments: [s].
    """
    following, out, end = Following(LAW), [], flight.segments[-1].end
    at = [min(moment, end) for moment in moments]
    for part, now in [*growing(flight, following.next_look), (flight, end)]:
        if now > at[-1]:
            break
        state = following.look(part, now)
        if not any(abs(now - moment) < 1e-6 for moment in at):
            continue
        moment, paper, known = moments[at.index(now)], by_paper(part, now), truths(part)
        for axis in axes:
            if axis not in known:
                continue
            one = state.axes[axis]
            mine: Told = {n: (one.values[n], *one.ci95[n]) for n in COEFFICIENTS if one.values[n] is not None}
            truth, bound = known[axis]
            signal = signal_of(part, axis)
            delay, wind, noise = help_of(axis)
            every = {
                "track": mine,
                "rls": least_squares(signal, delay, directional=False),
                "sift": least_squares(signal, delay, directional=True),
                "ekf": kalman(signal_of(part, axis, resampled=False), delay, wind, noise),
                "paper": paper.get(axis, {}),
                "xcorr": correlation(signal),
            }
            for method, told in every.items():
                out += scored(method, told, moment, truth, bound, list(mine))
    return out


def simulated(design: Design) -> list[Score]:
    """The scores of one simulated flight."""

    def truths(part: Flight) -> dict[str, tuple[Array, Array]]:
        return {axis: (truth_of(design, axis), bound) for axis, bound in bounds(design, part).items()}

    def help_of(axis: str) -> tuple[float, tuple[float, float], float]:
        k, truth = AXES.index(axis), design.truth
        return truth.delay[k], (truth.wind_sigma[k], truth.wind_time[k]), truth.mocap_noise[k]

    return looked_at(flown(design), ("z", "yaw"), truths, help_of, MOMENTS)


def on_record(name: str) -> list[Score]:
    """The scores of one recorded flight, against its batch fit."""
    path, axis = RECORDED[name]
    (flight,), _ = recorded([(path, (None, None))], [])()
    batch = fit([flight], structure=LAW).model.axes[axis]
    truth = np.array([getattr(batch, n) if getattr(batch, n) is not None else np.nan for n in COEFFICIENTS])
    error = np.array([batch.stderr[n] if batch.stderr[n] is not None else np.nan for n in COEFFICIENTS], float)
    delay = float(truth[2]) if np.isfinite(truth[2]) else 0.2
    return looked_at(
        flight, (axis,), lambda _part: {axis: (truth, error)}, lambda _axis: (delay, (0.1, 1.0), 1e-3), MOMENTS
    )


def printed(title: str, scores: Sequence[Score]) -> None:
    """The table: median error in bounds, and coverage."""
    print(f"\n{title}: median error in bounds (share of the 95 % intervals that hold the truth)")
    print(f"{'':8}{'':9}" + "".join(f"{f'{moment:g} s':>15}" for moment in MOMENTS))
    for name in COEFFICIENTS:
        for method in dict.fromkeys(score[0] for score in scores if score[1] == name):
            cells = []
            for moment in MOMENTS:
                there = [(off, held) for m, n, t, off, held in scores if (m, n, t) == (method, name, moment)]
                off = np.median([off for off, _ in there]) if there else np.nan
                held = [h for _, h in there if h is not None]
                share = f" ({100 * np.mean(held):3.0f} %)" if held else ""
                cells.append(f"{f'{off:.2f}{share}':>15}")
            print(f"{name:8}{method:>8} " + "".join(cells), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flights", nargs="?", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--recorded", action="store_true", help="two recorded flights, too")
    given = parser.parse_args()
    with ProcessPoolExecutor(given.jobs) as pool:
        for closed in (False, True) if given.flights else ():
            every = pool.map(simulated, designs(given.flights, closed))
            printed("closed loop" if closed else "open loop", [score for scores in every for score in scores])
        if given.recorded and REAL_FLIGHTS.is_dir():
            for name, scores in zip(RECORDED, pool.map(on_record, RECORDED), strict=True):
                printed(f"{name}, against its batch fit", scores)


if __name__ == "__main__":
    main()
