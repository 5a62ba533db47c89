"""The probable cause of a change: the estimated shifts of the coefficients, compared with those of each cause.

A cause is a subspace of the shifts: some coefficients change, by a common factor or each by itself, and the others do
not. Each is fitted to the shifts of all axes, weighted by their precision; axes that stayed count as much as those that
moved. Schwarz's criterion compares them by twice the negative logarithm of their evidence,

    sum (n + d) log(1 + r / n) + k log(60)

with the sum over the likelihoods: r is the residual sum of squares, d the number of directions, n the degrees of
freedom of their variance (the shifts have a multivariate t distribution), k the number of parameters. The cause with
the largest share of the evidence, summed over its subspaces, is named, and its share says how certain it is. Where the
change may have come at several instants, the evidence is summed over these, too, with (n + d) log(1 + T / n) less in
the costs of each: the likeliest one alone may be that at which a wrong cause fits by chance.

Source: G. Schwarz, Ann. Statist. 6 (1978), pp. 461-464; K. L. Lange, R. J. A. Little, J. M. G. Taylor, J. Am. Statist.
Assoc. 84 (1989), pp. 881-896 (multivariate t).
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array, Mask
from rotorfit.core.model import NORMAL
from rotorfit.core.tracked import RATIOS, Cause
from rotorfit.tracking.changes import Contrast
from rotorfit.tracking.scores import Scores
from rotorfit.tracking.shift import CURVED, WIDE

PRICE = float(np.log(60.0))
"""Penalty for each parameter of a cause: the logarithm of the number of independent samples in about two seconds."""

ROUNDING = 1e-9
"""Information about a coefficient, relative to the best known one of its likelihood, below which it is rounding."""

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
        shifted: `AXIS.QUANTITY` of each coefficient that it shifts.
        change: Those of which the flight tells by how much, to the 95 % interval of it: the ratio of new to old, or the
            difference of a delay [s] or trim [m/s^2, rad/s^2].
        confidence: Share of the evidence for this cause, on any axes.
        why: The reason, in one sentence.
    """

    cause: Cause
    axes: tuple[str, ...]
    shifted: tuple[str, ...]
    change: Mapping[str, tuple[float, float]]
    confidence: float
    why: str


def diagnosis(*instants: Sequence[tuple[Scores, Contrast]]) -> Diagnosis:
    """Names the cause of a change.

    Args:
        instants: For each instant at which it may have come, equally likely beforehand: scores and contrast of each
            likelihood. A cause must involve the likelihood with the largest statistic.
    """
    found = [each for parts in instants for each in _weighed(parts)]
    most = max(one.evidence for one in found)
    share = np.exp([one.evidence - most for one in found])
    evidence = {
        cause: float(sum(share[i] for i, one in enumerate(found) if one.cause == cause) / share.sum())
        for cause in dict.fromkeys(one.cause for one in found)
    }
    cause = max(evidence, key=lambda one: evidence[one])
    best = max((one for one in found if one.cause == cause), key=lambda one: one.evidence)
    shifted = [name for name, wide in zip(best.names, best.error, strict=True) if wide > 0.0]
    if cause in ("payload", "thrust"):  # what else moves follows the push
        shifted = [name for name in shifted if name.endswith(".trim")]
    change = _intervals(best.names, best.shift, best.error, best.scale)
    change = {name: interval for name, interval in change.items() if name in shifted}
    axes = tuple(dict.fromkeys(name.split(".")[0] for name in shifted))
    second = max(((each, one) for one, each in evidence.items() if one != cause), default=None)
    return Diagnosis(cause, axes, tuple(shifted), change, evidence[cause], _why(cause, second))


@dataclass(frozen=True)
class _Weighed:
    """A subspace of the shifts of a cause, at one instant.

    Attributes:
        cause: The cause.
        evidence: Logarithm of its evidence, up to a constant that all instants share.
        names: `AXIS.QUANTITY` of each coefficient that may shift.
        scale: Its unit, shape (P,).
        shift: Its shift by the cause, shape (P,).
        error: The standard error of that, shape (P,); 0 where it does not shift.
    """

    cause: Cause
    evidence: float
    names: Sequence[str]
    scale: Array
    shift: Array
    error: Array


def _weighed(parts: Sequence[tuple[Scores, Contrast]]) -> list[_Weighed]:
    """The evidence for each cause of a change that came at one instant."""
    names = [name for scores, _ in parts for name in scores.names]
    shift = np.concatenate([found.shift for _, found in parts])
    scale = np.concatenate([scores.scale for scores, _ in parts])
    ends = np.cumsum([0, *(found.shift.size for _, found in parts)])
    own = [slice(begin, end) for begin, end in itertools.pairwise(ends)]
    precision = np.zeros((shift.size, shift.size))
    for one, part in zip(own, parts, strict=True):
        precision[one, one] = _bent(*part)
    shown = set(max(parts, key=lambda part: part[1].statistic)[0].names)
    concerned = [name in shown for name in names]
    told = [found.precision.diagonal() for _, found in parts]
    seen = np.concatenate([each > ROUNDING * each.max() for each in told])  # without information: part of no cause
    causes = [(cause, basis) for cause, basis in _causes(names, seen) if basis[concerned].any()]
    fitted = [_fitted(basis, shift, precision) for _, basis in causes]
    named = np.array([cause for cause, _ in causes])
    costs = PRICE * np.array([basis.shape[1] for _, basis in causes])
    costs[named == "other"] += 2 * np.log(max(np.sum(named == "other"), 1))  # together as likely as each named one
    for one, (_, found) in zip(own, parts, strict=True):
        off = np.array([shift[one] - moved[one] for moved, _ in fitted])
        residual = np.maximum(np.einsum("ij,jk,ik->i", off, precision[one, one], off), 0.0)
        costs += (found.freedom + found.directions) * (
            np.log1p(residual / found.freedom) - np.log1p(found.statistic / found.freedom)
        )
    return [
        _Weighed(cause, -0.5 * float(cost), names, scale, moved, error)
        for (cause, _), cost, (moved, error) in zip(causes, costs, fitted, strict=True)
    ]


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

    tilted = [name for name in names if name.startswith(("x.", "y."))]
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
    ]
    if each("yaw.trim").size:  # a weak rotor tilts the vehicle, too: a push that fades, and any coefficient follows it
        found.append(("thrust", each("z.trim", "yaw.trim", *tilted)))
    axes = dict.fromkeys(name.split(".")[0] for name in names)
    found += [("other", each(*names)), ("other", each(*tilted))]
    found += [("other", each(*(name for name in names if name.startswith(f"{axis}.")))) for axis in axes]
    used: list[tuple[Cause, Array]] = []
    for cause, basis in found:
        if basis.any() and not any(b.shape == basis.shape and np.array_equal(b, basis) for _, b in used):
            used.append((cause, basis))
    return used


def _fitted(basis: Array, shift: Array, precision: Array) -> tuple[Array, Array]:
    """Fitted shifts of a cause and their standard errors, shape (P,)."""
    inverse = np.linalg.pinv(basis.T @ precision @ basis, rcond=1e-9, hermitian=True)
    moved = basis @ (inverse @ (basis.T @ precision @ shift))
    return moved, np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, inverse, basis), 0.0))


def _intervals(names: Sequence[str], moved: Array, error: Array, scale: Array) -> dict[str, tuple[float, float]]:
    """95 % intervals of what changed, in natural units; of a coefficient of which the data tell less there is none."""
    return {
        name: natural(name, ((value - NORMAL * wide) * size, (value + NORMAL * wide) * size))
        for name, value, wide, size in zip(names, moved, error, scale, strict=True)
        if 0.0 < wide <= WIDE
    }


def natural(name: str, shift: tuple[float, float]) -> tuple[float, float]:
    """An interval of a shift in natural units: the ratio of new to old, or the difference of a delay or trim."""
    low, high = shift
    kind = name.split(".")[1]
    if kind == "input":  # the motion is linear in the gain, not in its logarithm
        return float(1 + low), float(1 + high)
    return (float(np.exp(low)), float(np.exp(high))) if kind in RATIOS else (float(low), float(high))


def _why(cause: Cause, second: tuple[float, Cause] | None) -> str:
    """The reason for a cause, and the share of the next likely one."""
    if second is None:
        return WORDS[cause]
    share, other = second
    much = f"{100 * share:.0f} %" if share >= 0.01 else "less than 1 %"
    return f"{WORDS[cause]}; the next likely cause, {other!r}, has {much} of the evidence"
