"""How long a command acts without a successor, inferred from the motion of the vehicle during gaps in its commands.

A gap does not show what acted in it: the last command (the vehicle keeps it, or the sender repeated it without logging)
or none (a time-out stopped the vehicle). The response of a first-order vehicle is linear in the commands, so the
velocity is regressed on the response to ended commands and on the additional response if they are kept; the share of
the latter is 1 or 0:

    velocity = g (response to ended + share (response to kept - response to ended)) + slowly varying remainder

Gaps are judged from short to long. A long gap is bridged only if the motion supports it, a short one unless the motion
contradicts it.
"""

from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.display import counted
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import AXES, Array, Mask
from rotorfit.core.log import Log
from rotorfit.core.model import NORMAL
from rotorfit.flights.clocks.lag_search import GriddedMotion
from rotorfit.flights.clocks.motion_signals import ANSWER_STEP, DAMPINGS, HALF_WIDTH, answers, motion_column, seen_by
from rotorfit.flights.stamps import GAP_PERIODS, GAP_TOLERANCE, median_period
from rotorfit.flights.streams import Stream, commands_of

SHORT = 0.25
"""Gaps up to this are bridged unless the motion contradicts it [s]: time-outs of autopilots are longer (Crazyflie and
PX4 0.5 s, ArduPilot 3 s, Parrot and Tello practically none), and a segment costs 0.6 s at its start."""

LONGEST = 10.0
"""Longer gaps are not tested [s]: what follows them is another flight."""

WORST = 0.3
"""Standard error of the share above which the motion is uninformative."""

DELAYS = (-0.1, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6)
"""Delays of the response that are tried [s]."""

EVERY = 0.1
"""Interval over which changes of velocity are compared [s]: short for gusts, long for commands."""

FILLED = 0.6
"""Share of the usual number of poses that a velocity window must hold: in a gap of the poses it is interpolated."""

TOGETHER = 1.0
"""Time within which errors may be correlated [s]."""

FASTEST = 1e3
"""Velocities above this are not motion [m/s or rad/s]."""

MEANINGLESS = 1e100
"""Responses above this come from invalid commands."""

ENDLESS = 1e9
"""A hold [s] that ends only where the commands are closed."""


@dataclass(frozen=True)
class Share:
    """Share of the held command that the vehicle followed through some gaps: 1 if it was kept, 0 if it ended."""

    value: float
    error: float

    @property
    def known(self) -> bool:
        """Whether the share distinguishes the two: its 95 % interval excludes a half."""
        return self.error < WORST and abs(self.value - 0.5) > NORMAL * self.error


@dataclass(frozen=True)
class _Level:
    """Gaps of similar length: mask of the commands before them, shape (N,), the longest [s], and their share."""

    gap: Mask
    longest: float
    share: Share | None
    kept: bool


def with_judged_hold(log: Log, card: Card, commands: Stream, axes: tuple[str, ...], poses: Stream) -> Stream:
    """The commands with the hold inferred from the vehicle's motion, and a note that gives the reason.

    Nothing changes where the card states a hold, or where no step between commands exceeds three median periods.

    Args:
        log: As recorded.
        card: The meaning of each column.
        commands: With the default hold of three median periods.
        axes: The commanded axes.
        poses: Fresh, in order.
    """
    period = median_period(commands.stamps)
    if card.hold is not None or period is None:
        return commands
    endless = commands_of(log, replace(card, hold=ENDLESS))[0]
    steps = np.diff(endless.stamps)
    timed_out = endless.until[:-1] >= endless.stamps[1:]  # the command ended by time alone
    gaps = np.append(timed_out & (steps > (GAP_PERIODS + GAP_TOLERANCE) * period) & (steps <= LONGEST * 1e9), False)
    if not np.any(gaps):
        return commands
    levels = _judged(endless, gaps, GAP_PERIODS * period, axes, card.command_frame == "world", poses)
    longest = max((level.longest for level in levels if level.kept), default=0.0)
    hold = max(GAP_PERIODS * period / 1e9, longest)
    held = commands_of(log, replace(card, hold=hold))[0] if longest else commands
    count = int(np.sum(gaps))
    note = Note(
        "hold_judged", _sentence(levels, hold, f"{counted(count, 'gap')} longer than three median periods"), count
    )
    return replace(held, notes=(*held.notes, note))


def _judged(commands: Stream, gaps: Mask, hold: int, axes: tuple[str, ...], world: bool, poses: Stream) -> list[_Level]:
    """The gaps grouped by length, short ones first, up to the first group that is not kept."""
    length = np.append(np.diff(commands.stamps), 0) / 1e9
    seen, base = well_seen(poses), (int(poses.stamps[0]) - int(commands.stamps[0])) / 1e9
    moving = tuple(axis for axis in axes if np.ptp(commands.values[:, AXES.index(axis)]) > 0)
    levels: list[_Level] = []
    kept, limit = np.zeros_like(gaps), SHORT
    while np.any(gaps & ~kept):
        new = gaps & ~kept & (length <= limit)
        if np.any(new):
            ended, followed = (answers(_ended(commands, gaps & ~some, hold)) for some in (kept, kept | new))
            share = _share(seen, base, ended, followed, moving, world)
            told = share is not None and share.known
            good = bool(share and share.value > 0.5) if told else limit == SHORT
            levels.append(_Level(new, float(length[new].max()), share, good))
            if not good:
                break
            kept = kept | new
        limit *= 2
    return levels


def well_seen(poses: Stream) -> GriddedMotion:
    """The motion, valid only where its poses have no gap."""
    seen, time = seen_by(poses), (poses.stamps - poses.stamps[0]) / 1e9
    grid = seen.start + seen.step * np.arange(seen.valid.size)
    count = np.diff(np.searchsorted(time, [grid - HALF_WIDTH, grid + HALF_WIDTH]), axis=0)[0]
    usual = 2 * HALF_WIDTH / float(np.median(np.diff(time)))
    return replace(seen, valid=seen.valid & (count >= FILLED * usual))


def _ended(commands: Stream, gaps: Mask, hold: int) -> Stream:
    """The commands with a zero command at the start of each gap, every command acting until the next."""
    stamps = np.concatenate([commands.stamps, commands.stamps[gaps] + hold])
    values: Array = np.concatenate([commands.values, np.zeros((int(np.sum(gaps)), len(AXES)))])
    order = np.argsort(stamps, kind="stable")
    stamps = stamps[order]
    return replace(commands, stamps=stamps, values=values[order], until=np.append(stamps[1:], stamps[-1] + hold))


def _share(
    seen: GriddedMotion, base: float, ended: GriddedMotion, followed: GriddedMotion, axes: tuple[str, ...], world: bool
) -> Share | None:
    """The share over all axes together; None where the motion of none is informative.

    Args:
        seen: The motion.
        base: Time from the first command to the first pose [s].
        ended: Responses to the commands with the gaps ended.
        followed: Responses with the commands kept.
        axes: The moving axes.
        world: Whether commands are along the world axes.
    """
    row = np.flatnonzero(seen.valid)
    every = max(1, round(EVERY / seen.step))
    if row.size <= 2 * every:
        return None
    row = row[::every]
    time: Array = base + seen.step * row.astype(np.float64)
    more = followed.value[: len(ended.value)] - ended.value
    found = []
    for axis in axes:
        velocity = seen.value[row, motion_column(axis, world)]
        if not np.ptp(velocity) or not np.abs(velocity).max() < FASTEST:
            continue
        change, first = np.diff(velocity), AXES.index(axis) * len(DAMPINGS)
        both = ended.value[:, first : first + len(DAMPINGS)], more[:, first : first + len(DAMPINGS)]
        left = np.concatenate([_unexplained(change, _regressors(time - delay, *both)) for delay in DELAYS])
        for best in np.argsort(left)[: np.sum(np.isfinite(left))]:
            delay, damping = divmod(int(best), len(DAMPINGS))
            X = _regressors(time - DELAYS[delay], *(part[:, damping : damping + 1] for part in both))[0]
            if share := _regressed(change, X, time):
                found.append(share)
                break
    weights = np.array([1 / share.error**2 for share in found])
    if not found:
        return None
    value = float(weights @ [share.value for share in found] / weights.sum())
    return Share(value, float(1 / np.sqrt(weights.sum())))


def _regressors(time: Array, ended: Array, more: Array) -> Array:
    """A trend and the changes of two responses from each time to the next, for B dampings, shape (B, N - 1, 3).

    Args:
        time: Shape (N,) [s].
        ended: Response to the commands with the gaps ended, every `ANSWER_STEP`, shape (M, B).
        more: Additional response if the commands are kept, shape (M, B).
    """
    place = np.clip(time / ANSWER_STEP, 0, len(ended) - 1)
    low = np.minimum(place.astype(np.int64), len(ended) - 2)
    part = (place - low)[:, None]
    X = np.ones((ended.shape[1], time.size - 1, 3))
    for k, response in enumerate((ended, more), 1):
        X[:, :, k] = np.diff((1 - part) * response[low] + part * response[low + 1], axis=0).T
    return X


def _unexplained(change: Array, X: Array) -> Array:
    """Sum of the squared changes that each of B sets of regressors leaves unexplained; infinite if it is singular."""
    left = np.full(len(X), np.inf)
    meant = np.flatnonzero(np.abs(X).max(axis=(1, 2)) < MEANINGLESS)
    gram = np.swapaxes(X[meant], 1, 2) @ X[meant]
    regular = np.linalg.matrix_rank(gram) == X.shape[2]
    for i, G in zip(meant[regular], gram[regular], strict=True):
        rest = change - X[i] @ np.linalg.solve(G, X[i].T @ change)
        left[i] = rest @ rest
    return left


def _regressed(change: Array, X: Array, time: Array) -> Share | None:
    """Regresses changes of a velocity on those of two responses; None without a standard error.

    Source: standard errors clustered by time, K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986), pp. 13-22.
    """
    gram = X.T @ X
    theta = np.linalg.solve(gram, X.T @ change)
    rest = change - X @ theta
    group = np.floor((time[1:] - time[0]) / TOGETHER).astype(np.int64)
    scores = np.column_stack([np.bincount(group, column) for column in (X * rest[:, None]).T])
    inverse = np.linalg.inv(gram)
    _, whole, part = theta
    slope = inverse @ [0.0, -part / whole**2, 1 / whole]
    alike = float(rest @ rest) / max(change.size - 3, 1)  # few gaps make few clusters: use the pooled variance then
    error = float(np.sqrt(max(slope @ (scores.T @ scores) @ slope, alike * (slope @ gram @ slope))))
    return Share(float(part / whole), error) if np.isfinite(error) and error > 0 else None


def _sentence(levels: list[_Level], hold: float, found: str) -> str:
    """Which gaps were bridged, and why, in one sentence."""
    parts = []
    for level in levels:
        what = f"{counted(int(np.sum(level.gap)), 'gap')} of up to {level.longest:.3f} s"
        if level.share and level.share.known:
            why = f"the vehicle followed {level.share.value:.2f} +- {NORMAL * level.share.error:.2f} of it"
        else:
            why = f"the motion does not show it{', and vehicles hold commands for longer' if level.kept else ''}"
        kept = "is assumed to keep acting" if level.kept else "is assumed to have ended"
        parts.append(f"through {what} the last command {kept}: {why}")
    return f"{found}: a command is held for {hold:.3f} s at most; {'; '.join(parts)}"
