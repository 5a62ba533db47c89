"""The ladder: every estimator on the same flights, in one table, each tested against the likelihood."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rotorfit.assessment.advice import instrument_not_valid, with_advice
from rotorfit.assessment.validation import alone_in_the_plane, horizon_scores
from rotorfit.core.display import short_repr
from rotorfit.core.finding import Finding, by_gravity
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, FROZEN, NORMAL, STRUCTURE, Axis
from rotorfit.core.progress import Progress
from rotorfit.core.results import Fit, Horizon
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.methods import BEST, compared_methods

HORIZON = 1.0
"""Horizon of the predictions shown [s]."""

DIFFERS = 2.5758293035489004
"""Standard errors beyond which two estimates differ: 1 % of those that agree do. A table has some fifty tests."""

MORE_VARIANCE = 2.0
"""Minimum ratio of a rung's variance to that of the likelihood for their difference to be a variance itself."""


DENIED = ("refuted", "not_excited", FROZEN)
"""Statuses that the likelihood gives for what is wrong in the law or in the flight, and so in every rung."""


NOT_VALID = "not valid here: the commands seem to answer the motion, and no reference was recorded"
"""Remark on an instrument computed from commands that come from a feedback loop."""


@dataclass(frozen=True)
class Agreement:
    """A coefficient of a rung compared with that of the likelihood.

    Attributes:
        difference: Rung minus likelihood.
        stderr: Standard error of the difference.
        how: `hausman` or `bound`; see `agreement`.
        agrees: Whether the difference is within `DIFFERS` standard errors.
    """

    difference: float
    stderr: float
    how: str
    agrees: bool


@dataclass(frozen=True)
class MethodRow:
    """One rung, one axis.

    Attributes:
        method: Name of the rung.
        axis: Result of the rung for the axis.
        status: Coefficient name to its status. It is that of the likelihood where that refutes the law, or where the
            commands explain nothing to it: the number of the rung stays, and is not one of the vehicle.
        agreement: Coefficient name to its test; only coefficients that both estimate.
        prediction: RMSE of 1 s velocity predictions on the same flights [m/s or rad/s]; None without a model.
        remark: Comment on its numbers: why there is none, which instrument, whether it is valid.
    """

    method: str
    axis: Axis
    status: Mapping[str, str]
    agreement: Mapping[str, Agreement]
    prediction: float | None
    remark: str


@dataclass(frozen=True)
class Ladder:
    """All rungs on the same flights.

    Attributes:
        paths: Paths of the logs.
        axes: Axis name to its rows, in the order of `compared_methods`.
        held: Axis name to the error of predictions that hold the velocity.
        findings: Of the flights, and of their fit by the likelihood: an error of the data or of the law is common to
            all rungs, so that no agreement of theirs shows it.
    """

    paths: tuple[str, ...]
    axes: Mapping[str, tuple[MethodRow, ...]]
    held: Mapping[str, float | None]
    findings: tuple[Finding, ...] = ()

    __repr__ = short_repr


def ladder(flights: Sequence[Flight], axes: Sequence[str] = AXES, progress: Progress | None = None) -> Ladder:
    """Fits every rung to the same flights and tests it against the likelihood.

    Args:
        flights: Recorded with one card.
        axes: Which axes are wanted.
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        FlightError: No flight is given, or their cards differ in the meaning of the coefficients.
    """
    fits: dict[str, Fit] = {}
    scores: dict[str, Sequence[Mapping[str, Horizon]]] = {}
    held: Sequence[Mapping[str, Horizon]] = ()
    methods = compared_methods()
    for number, method in enumerate(methods):
        if progress:
            progress(number / len(methods), method)
        fits[method] = fit(flights, method, axes, structure=STRUCTURE)  # rungs differ in method, not in law
        found = [horizon_scores(fits[method].model, flight, HORIZON) for flight in fits[method].flights]
        scores[method], held = [own for own, _ in found], [hold for _, hold in found]
    fits[BEST] = with_advice(fits[BEST], flights, axes)
    best = fits[BEST].model
    wanted = [axis for axis in AXES if axis in axes]
    served = {axis: [axis in source.axes for source in best.flights] for axis in wanted}
    rows = {
        axis: tuple(
            MethodRow(
                method=method,
                axis=fitted.model.axes[axis],
                status=statuses(fitted.model.axes[axis], best.axes[axis]),
                agreement={} if method == BEST else agreement(fitted.model.axes[axis], best.axes[axis]),
                prediction=_pooled(scores[method], axis, served[axis]),
                remark=_remark(fitted, axis),
            )
            for method, fitted in fits.items()
        )
        for axis in wanted
    }
    errors = {axis: _pooled(held, axis, served[axis]) for axis in wanted}
    told = [finding for finding in best.findings if finding.axis is None or finding.axis in wanted]
    known = [axis for axis in wanted if any(row.prediction is not None for row in rows[axis])]
    told += alone_in_the_plane(known, fits[BEST].flights)
    return Ladder(tuple(f.path for f in flights), rows, errors, by_gravity(told))


def _remark(fitted: Fit, axis: str) -> str:
    """What a rung says of its numbers, and whether its instrument is one."""
    remark = fitted.remarks.get(axis, "")
    return f"{remark}; {NOT_VALID}" if instrument_not_valid(fitted, axis) else remark


def _pooled(scores: Sequence[Mapping[str, Horizon]], axis: str, served: Sequence[bool]) -> float | None:
    """RMSE over the flights that command the axis."""
    errors = [flight[axis] for flight, serves in zip(scores, served, strict=True) if serves]
    known = [(error.n, error.velocity_rmse) for error in errors if error.velocity_rmse is not None]
    return float(np.sqrt(sum(n * e**2 for n, e in known) / sum(n for n, _ in known))) if known else None


def statuses(rung: Axis, best: Axis) -> dict[str, str]:
    """The status of each coefficient of a rung; that of the likelihood where it denies the number of any rung.

    All rungs fit one law to one flight, but only the likelihood tests both.

    Args:
        rung: An axis as estimated by a rung.
        best: The same axis as estimated by the likelihood.
    """
    return {
        name: best.status[name] if rung.status[name] == "ok" and best.status[name] in DENIED else rung.status[name]
        for name in COEFFICIENTS
    }


def agreement(rung: Axis, best: Axis) -> dict[str, Agreement]:
    """Tests the coefficients of a rung against those of the likelihood, on the same data.

    The estimates share the data, so the variance of their difference is not the sum of their variances. If both are
    right and the likelihood is efficient, it is the difference of the variances (`hausman`). The rung's variance is
    itself an estimate, so this is used only where it is at least twice that of the likelihood. Otherwise the standard
    error is the sum of both (`bound`), which no correlation can exceed: the test then has less power, but is never too
    strict.

    Args:
        rung: An axis as estimated by a rung.
        best: The same axis as estimated by the likelihood.

    Source: J. A. Hausman, Econometrica 46 (1978), pp. 1251-1271; the bound is Minkowski's inequality.
    """
    found = {}
    for name in COEFFICIENTS:
        value, other = getattr(rung, name), getattr(best, name)
        error, least = _error(rung, name), _error(best, name)
        if value is None or other is None or error is None or least is None:
            continue
        own = error**2 >= MORE_VARIANCE * least**2
        spread = float(np.sqrt(error**2 - least**2)) if own else error + least
        difference = value - other
        agrees = abs(difference) <= DIFFERS * spread
        found[name] = Agreement(difference, spread, "hausman" if own else "bound", agrees)
    return found


def _error(axis: Axis, name: str) -> float | None:
    """Standard error of a coefficient over flights like these: as its 95 % interval of them has it, if that is closed.

    That of the vehicle allows for how flights differ, which no difference of two estimates from one flight contains.
    """
    low, high = axis.ci95_flight.get(name, axis.ci95[name])
    return axis.stderr[name] if low is None or high is None else (high - low) / (2 * NORMAL)


def to_mapping(result: Ladder) -> dict[str, Any]:
    """The ladder as plain JSON types."""
    return {
        "logs": list(result.paths),
        "horizon": HORIZON,
        "axes": {
            axis: {"rungs": [_row(row) for row in rows], "held": result.held[axis]}
            for axis, rows in result.axes.items()
        },
        "findings": [asdict(finding) for finding in result.findings],
    }


def _row(row: MethodRow) -> dict[str, Any]:
    return {
        "method": row.method,
        **{name: getattr(row.axis, name) for name in COEFFICIENTS},
        "stderr": dict(row.axis.stderr),
        "ci95": {name: list(ends) for name, ends in row.axis.ci95.items()},
        "status": dict(row.status),
        "agreement": {name: asdict(test) for name, test in row.agreement.items()},
        "prediction": row.prediction,
        "remark": row.remark,
    }
