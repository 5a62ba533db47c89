"""The probable cause of a change: the estimated shifts of the coefficients, compared with those of each cause.

A cause is a subspace of the shifts: some coefficients change, by a common factor or each by itself, and the others do
not. Each cause is fitted to the shifts, weighted by their precision. Schwarz's criterion selects one by its residual
and its number of parameters; the share of each cause in the evidence says how certain the choice is.

Source: G. Schwarz, Ann. Statist. 6 (1978), pp. 461-464.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array, Mask
from rotorfit.core.model import NORMAL
from rotorfit.core.tracked import Cause
from rotorfit.tracking.changes import Contrast
from rotorfit.tracking.scores import Scores

PRICE = float(np.log(60.0))
"""Penalty for each parameter of a cause: the logarithm of the number of independent samples in about two seconds."""

CURVED = 0.1
"""Error of the first-order shift over the square of the shift, both in units of `scores.EXPECTED`."""

WORDS: Mapping[Cause, str] = {
    "payload": "a payload was taken up or dropped, or thrust was lost evenly: weight against thrust has changed",
    "thrust": "thrust was lost on one side: weight against thrust and the torque about the vertical have changed",
    "limits": "the answer to full commands changed by one factor: another limit or mode",
    "delay": "all answers come later or earlier by the same time: radio, clock or computer",
    "other": "no single cause explains it",
}


@dataclass(frozen=True)
class Diagnosis:
    """A named change.

    Attributes:
        cause: The most probable cause.
        axes: The axes that it changes.
        change: `AXIS.QUANTITY` to the 95 % interval of the change: the ratio of new to old, or the difference of a
            delay [s] or trim [m/s^2, rad/s^2].
        confidence: Share of the evidence for this cause, on any axes.
        why: The reason, in one sentence.
        plain: Share of the evidence for this cause on exactly these axes.
    """

    cause: Cause
    axes: tuple[str, ...]
    change: Mapping[str, tuple[float, float]]
    confidence: float
    why: str
    plain: float


def diagnosis(parts: Sequence[tuple[Scores, Contrast]]) -> Diagnosis:
    """Names the cause of a change.

    Args:
        parts: Scores and contrast of each likelihood, for a change at one instant. A cause must involve the likelihood
            with the largest statistic.
    """
    names = [name for scores, _ in parts for name in scores.names]
    shift = np.concatenate([found.shift for _, found in parts])
    scale = np.concatenate([scores.scale for scores, _ in parts])
    precision = np.zeros((shift.size, shift.size))
    at = 0
    for scores, found in parts:
        size = found.shift.size
        precision[at : at + size, at : at + size] = _bent(scores, found)
        at += size
    shown = set(max(parts, key=lambda part: part[1].statistic)[0].names)
    concerned = [name in shown for name in names]
    seen = precision.diagonal() > 0  # a coefficient without information takes part in no cause
    causes = [(cause, basis) for cause, basis in _causes(names, seen) if basis[concerned].any()]
    fitted = [(cause, _fitted(basis, shift, precision)) for cause, basis in causes]
    costs = np.array([left + PRICE * np.linalg.matrix_rank(basis) for _, (left, _, _, basis) in fitted])
    share = np.exp(-0.5 * (costs - costs.min()))
    share /= share.sum()
    best = int(np.argmin(costs))
    cause, (_, moved, error, _) = fitted[best]
    change = _intervals(names, moved, error, scale)
    axes = tuple(dict.fromkeys(name.split(".")[0] for name in change))
    others = sorted(zip(share, fitted, strict=True), key=lambda pair: -pair[0])
    second = next(((s, c) for s, (c, _) in others if c != cause), None)
    confidence = float(share[[c == cause for c, _ in fitted]].sum())
    return Diagnosis(cause, axes, change, confidence, _why(cause, second), float(share[best]))


def _bent(scores: Scores, found: Contrast) -> Array:
    """Precision of a first-order shift, lowered where the shift is large enough for the second order to matter.

    Trims enter linearly and have no second order.
    """
    additive = np.array([name.endswith(".trim") for name in scores.names])
    size = float(np.sum(np.where(additive, 0.0, found.shift) ** 2))
    bend = np.where(additive, 0.0, (CURVED * size) ** 2)
    if not bend.any():
        return found.precision
    weight = 1 / np.maximum(bend, 1e-9)  # (P^-1 + W)^-1 = P - P (P + W^-1)^-1 P
    return found.precision - found.precision @ np.linalg.solve(found.precision + np.diag(weight), found.precision)


def _causes(names: Sequence[str], seen: Mask) -> list[tuple[Cause, Array]]:
    """Each cause with a basis of its shifts, shape (P, k), restricted to the coefficients that are seen, shape (P,)."""

    def alike(*wanted: str) -> Array:
        return (seen & np.isin(names, wanted)).astype(float)[:, None]

    def each(*wanted: str) -> Array:
        return np.eye(len(names))[:, seen & np.isin(names, wanted)]

    gains, delays = ([n for n in names if n.endswith(f".{part}")] for part in ("input", "delay"))
    found: list[tuple[Cause, Array]] = [
        ("payload", each("z.trim")),
        ("payload", each("z.trim", "z.input", "z.damping")),
        ("thrust", each("z.trim", "yaw.trim")),
        ("thrust", each("yaw.trim")),
        ("delay", alike(*delays)),
        ("limits", alike(*gains)),
        ("limits", alike("x.input", "y.input")),
        *(("limits", each(gain)) for gain in gains),
        ("other", each(*names)),
    ]
    axes = dict.fromkeys(name.split(".")[0] for name in names)
    found += [("other", each(*(name for name in names if name.startswith(f"{axis}.")))) for axis in axes]
    used: list[tuple[Cause, Array]] = []
    for cause, basis in found:
        if basis.any() and not any(b.shape == basis.shape and np.array_equal(b, basis) for _, b in used):
            used.append((cause, basis))
    return used


def _fitted(basis: Array, shift: Array, precision: Array) -> tuple[float, Array, Array, Array]:
    """Residual sum of squares of a cause, its fitted shifts and their standard errors, shape (P,), and its basis."""
    inverse = np.linalg.pinv(basis.T @ precision @ basis, rcond=1e-9, hermitian=True)
    moved = basis @ (inverse @ (basis.T @ precision @ shift))
    off = shift - moved
    error = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, inverse, basis), 0.0))
    return float(off @ precision @ off), moved, error, basis


def _intervals(names: Sequence[str], moved: Array, error: Array, scale: Array) -> dict[str, tuple[float, float]]:
    """95 % intervals of what changed, in natural units."""
    out = {}
    for name, value, wide, size in zip(names, moved, error, scale, strict=True):
        if wide == 0.0:
            continue
        low, high = (value - NORMAL * wide) * size, (value + NORMAL * wide) * size
        kind = name.split(".")[1]
        if kind == "input":  # the motion is linear in the gain, not in its logarithm
            low, high = 1 + low, 1 + high
        elif kind not in ("delay", "trim"):
            low, high = float(np.exp(low)), float(np.exp(high))
        out[name] = (float(low), float(high))
    return out


def _why(cause: Cause, second: tuple[float, Cause] | None) -> str:
    """The reason for a cause, and the share of the next likely one."""
    if second is None:
        return WORDS[cause]
    share, other = second
    much = f"{100 * share:.0f} %" if share >= 0.01 else "less than 1 %"
    return f"{WORDS[cause]}; the next likely cause, {other!r}, has {much} of the evidence"
