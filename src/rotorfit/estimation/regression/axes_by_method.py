"""Results of the regressions in `METHODS`, as axes of a model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pkgutil import resolve_name

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.core.model import COEFFICIENTS, Axis
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.noise_levels import settle_levels, with_levels
from rotorfit.estimation.methods import METHODS
from rotorfit.estimation.regression.instrumental_variables import COMMAND
from rotorfit.estimation.regression.result import MethodResult, axis_of_rung

Estimator = Callable[[Sequence[Flight], tuple[str, ...]], MethodResult]
"""From flights of one vehicle and setting, and the axes that are estimated together, to their coefficients."""

NOT_VALID = "not valid here: the commands respond to the motion, and no reference was recorded"
"""Remark on an instrument computed from commands that come from a feedback loop."""


def estimator_of(method: str) -> Estimator:
    """The function behind a key of `METHODS` with an estimator."""
    estimator: Estimator = resolve_name(METHODS[method].estimator)
    return estimator


def axes_by_method(
    flights: Sequence[Flight], group: Sequence[str], method: str
) -> tuple[dict[str, Axis], dict[tuple[str, ...], Array], dict[str, str]]:
    """Estimates the axes of one group by one of the regressions.

    Args:
        flights: Flights that command one of the axes.
        group: x, y or both; z; or yaw.
        method: A key of `METHODS` with an estimator.

    Returns:
        The axes by name, with the disturbance levels for prediction and a trim for each flight; the covariance of
        (input, damping, delay) of the axes with numbers, keyed by the names of its rows, empty if no axis has numbers;
        and remarks by axis: why there is no number, which instrument was used, whether it is valid.
    """
    rung = estimator_of(method)(flights, ("x", "y") if set(group) & {"x", "y"} else tuple(group))
    place = {axis: rung.axes.index(axis) for axis in group}
    told = {axis: axis_of_rung(rung, axis) for axis in group}
    axes = with_levels(
        flights, {axis: _with_trim(known, rung.trim[:, place[axis]]) for axis, (known, _) in told.items()}
    )
    remarks = {axis: [part for part in (told[axis][1], rung.remark.get(axis, "")) if part] for axis in group}
    for axis in _answering(flights, {axis: axes[axis] for axis in group if COMMAND in rung.remark.get(axis, "")}):
        remarks[axis].append(NOT_VALID)
    known = [axis for axis in group if axes[axis].predictor]
    K = len(rung.axes)
    index = [offset + place[axis] for axis in known for offset in (0, K, 2 * K)]
    names = tuple(f"{axis}.{name}" for axis in known for name in COEFFICIENTS)
    blocks = {names: rung.covariance[np.ix_(index, index)]} if known else {}
    return axes, blocks, {axis: "; ".join(parts) for axis, parts in remarks.items() if parts}


def _with_trim(axis: Axis, trim: Array) -> Axis:
    return replace(axis, trim=tuple(float(c) if np.isfinite(c) and axis.predictor else None for c in trim))


def _answering(flights: Sequence[Flight], axes: Mapping[str, Axis]) -> list[str]:
    """Axes whose commands respond to innovations, as in a feedback loop."""
    points = {axis: known.predictor for axis, known in axes.items() if known.predictor}
    return [
        axis
        for group, records, optimum in (settle_levels(flights, points) if points else [])
        for k, axis in enumerate(group)
        if axis in points and answer_to_motion(records, optimum, k) > ANSWERED
    ]


ANSWERED = 4.0
"""Standard deviations beyond which commands count as a response to the motion."""

AHEAD = (3, 6, 12, 24)
"""Lags after an innovation at which a response of the command is tested [blocks of 1/30 s]."""

BEFORE = (0, 1, 2, 4, 8, 16)
"""Lags of the earlier commands that predict the later one without innovations [blocks of 1/30 s]."""


def answer_to_motion(records: Sequence[Record], optimum: Optimum, k: int) -> float:
    """How strongly later commands depend on innovations, beyond their prediction from earlier commands.

    Innovations are what the model did not predict. If they improve the prediction of the commands of the next second,
    the commands respond to the motion. A single change of the command shows little of the response, so the command
    itself, which sums the changes, is tested.

    Args:
        records: Input of the likelihood.
        optimum: Optimum with its levels estimated at the coefficients of a rung.
        k: Index of the axis in the optimum.

    Returns:
        The largest absolute statistic over the lags in `AHEAD`, each of unit variance in an open loop; 0 without enough
        data.

    Source: C. W. J. Granger, Econometrica 37 (1969), pp. 424-438.
    """
    products = np.zeros((2, len(AHEAD)))
    for rec, innovation in zip(records, optimum.score.innovations, strict=True):
        place = np.searchsorted(rec.command_time, rec.block_time, side="right") - 1
        command, e = rec.command[place, k], innovation[:, k]
        for column, ahead in enumerate(AHEAD):
            now = np.arange(max(BEFORE), command.size - ahead)
            if now.size < 4 * len(BEFORE):
                continue
            past = np.column_stack([np.ones(now.size), *(command[now - lag] for lag in BEFORE)])
            later = command[now + ahead]
            own = later - past @ np.linalg.lstsq(past, later, rcond=1e-10)[0]
            spread = float(np.median(np.abs(own)))
            own = np.clip(
                own, -spread, spread
            )  # steps of a pilot or a plan must not drown a controller's small answers
            products[:, column] += (e[now] @ own, (e[now] ** 2) @ own**2)
    known = products[1] > 0
    return float(np.abs(products[0, known] / np.sqrt(products[1, known])).max(initial=0.0))
