"""Commands smoothed by the logger: recognised by their shape, restored where the motion followed the original ones.

A logger that keeps a share a of the old value and takes 1 - a of the new one with every message turns a step into an
exponential: successive changes in the log shrink by the factor a while the command is held. Nothing else produces so
many changes with the same ratio. The original commands then follow exactly,

    sent_k = (logged_k - a logged_(k-1)) / (1 - a)

unless the sender smoothed them itself and the vehicle received the logged values. Motion that follows the original
commands decides; motion that follows the logged ones does not, because a vehicle with a lag does so in either case.
A smoothed command that is never held lacks this shape and is not recognised.
"""

from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Note
from rotorfit.core.frames import AXES, Array
from rotorfit.flights.clocks.lag_search import GriddedMotion
from rotorfit.flights.clocks.motion_signals import ANSWER_STEP, DAMPINGS, answers, motion_column
from rotorfit.flights.command_hold import DELAYS, EVERY, FASTEST, well_seen
from rotorfit.flights.streams import Stream

RATIOS = (0.3, 0.97)
"""Range of the kept share that is searched; ramps and slow sines have ratios near 1."""

SHARP = 0.003
"""Half width of the peak of the ratios."""

AROUND = 0.03
"""Half width of the neighbourhood that the peak is compared with."""

PEAK = 0.5
"""Share of the ratios in the neighbourhood that the peak must hold; uniform ratios give a tenth."""

LEAST_SHARE = 0.2
"""Share of all ratios that the peak must hold."""

FEWEST = 40
"""Least number of ratios in the peak."""

RATIO_NOISE = 1e-3
"""Largest ratio of rounding to change for which a change is used."""

DECIDES = 5.0
"""Difference of the log-likelihoods that decides which commands the vehicle followed."""

INDEPENDENT = 0.5
"""Time after which changes of the velocity count as independent [s]."""


@dataclass(frozen=True)
class _Fit:
    """Residual sum of squares of a velocity's changes regressed on the response to a command, and their number."""

    rest: float
    count: int


def kept_share(command: Array) -> float | None:
    """Share of the old value that a logger kept, from the shape of a command, shape (M,); None without such a shape.

    Source: the ratio of successive changes of a first-order recursion with a held input is its pole.
    """
    value = command[np.concatenate([[True], np.diff(command) != 0])]
    change = np.diff(value)
    if change.size <= FEWEST:
        return None
    rounding = 4 * np.finfo(np.float64).eps * float(np.abs(value).max())
    sizes = np.abs(change[:-1])
    told = sizes * RATIO_NOISE > rounding
    ratio = np.sort(change[1:][told] / change[:-1][told])
    inside = ratio[(ratio > RATIOS[0]) & (ratio < RATIOS[1])]
    if inside.size < FEWEST:
        return None
    count = np.searchsorted(inside, inside + SHARP) - np.searchsorted(inside, inside - SHARP)
    best = float(inside[int(np.argmax(count))])
    near = inside[np.abs(inside - best) < SHARP]
    wide = int(np.sum(np.abs(ratio - best) < AROUND))
    if near.size < max(FEWEST, LEAST_SHARE * ratio.size) or near.size < PEAK * wide:
        return None
    return float(np.median(near))


def without_low_pass(commands: Stream, axes: tuple[str, ...], poses: Stream, world: bool) -> Stream:
    """Restores commands that the log smooths, where the motion followed the original ones.

    Args:
        commands: In order.
        axes: The commanded axes.
        poses: Fresh, in order.
        world: Whether commands are along the world axes.

    Returns:
        The commands; where they have the shape of smoothed ones, with a note `commands_unfiltered` (restored) or
        `commands_low_pass` (as logged: the sender may have smoothed them, or the logger).
    """
    shares = {axis: share for axis in axes if (share := kept_share(commands.values[:, AXES.index(axis)])) is not None}
    if not shares:
        return commands
    values = commands.values.copy()
    for axis, share in shares.items():
        k = AXES.index(axis)
        values[1:, k] = (commands.values[1:, k] - share * commands.values[:-1, k]) / (1 - share)
    sent = replace(commands, values=values)
    seen, base = well_seen(poses), (int(poses.stamps[0]) - int(commands.stamps[0])) / 1e9
    better = sum(_gain(seen, base, answers(commands), answers(sent), axis, world) for axis in shares)
    what = ", ".join(f"{axis} {share:.3f}" for axis, share in shares.items())
    shape = f"{len(commands.stamps)} logged commands look low-pass filtered, keeping a share of the old value ({what})"
    if better > DECIDES:
        told = f"{shape}; unfiltered, they explain the motion better by {better:.0f} log units: it was undone"
        return replace(sent, notes=(*commands.notes, Note("commands_unfiltered", told, len(commands.stamps))))
    why = f"unfiltered, {better:+.1f} log units"
    if better < -DECIDES:  # any vehicle with a lag seems to: its answers are smooth, whatever it received
        why = f"as logged, they explain the motion better by {-better:.0f} log units, as of a slow vehicle, too"
    told = f"{shape}; the motion does not show whether the vehicle received them so ({why})"
    return replace(commands, notes=(*commands.notes, Note("commands_low_pass", told, len(commands.stamps))))


def _gain(
    seen: GriddedMotion, base: float, logged: GriddedMotion, sent: GriddedMotion, axis: str, world: bool
) -> float:
    """Log-likelihood of the motion of an axis given the restored commands, less that given the logged ones."""
    fits = [_best(seen, base, some, axis, world) for some in (logged, sent)]
    one, other = fits
    if one is None or other is None or not min(one.rest, other.rest) > 0:
        return 0.0
    return 0.5 * one.count * EVERY / INDEPENDENT * float(np.log(one.rest / other.rest))


def _best(seen: GriddedMotion, base: float, answer: GriddedMotion, axis: str, world: bool) -> _Fit | None:
    """The best regression of a velocity's changes on those of a response, over dampings and delays."""
    row = np.flatnonzero(seen.valid)[:: max(1, round(EVERY / seen.step))]
    velocity = seen.value[row, motion_column(axis, world)]
    if row.size < FEWEST or not 0 < np.ptp(velocity) < FASTEST:
        return None
    time: Array = base + seen.step * row.astype(np.float64)
    clock, change = ANSWER_STEP * np.arange(len(answer.value)), np.diff(velocity)
    left = np.inf
    for k in AXES.index(axis) * len(DAMPINGS) + np.arange(len(DAMPINGS)):
        for delay in DELAYS:
            moved = np.diff(np.interp(time - delay, clock, answer.value[:, k]))
            x = moved - moved.mean()
            y = change - change.mean()
            power = float(x @ x)
            left = min(left, float(y @ y) - float(x @ y) ** 2 / power) if power > 0 else left
    return _Fit(left, change.size) if np.isfinite(left) else None
