"""Model + flights -> the frequency response of each flight beside the model's, and whether its law allows it.

Source: R. A. Fisher, Statistical Methods for Research Workers, 4th ed., 1932 (several flights).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.assessment.frequency.law_test import SLOWEST, coordinates, law_test, point_at
from rotorfit.assessment.frequency.response import response_bands, response_of_bands
from rotorfit.assessment.whiteness import FINDING_LEVEL
from rotorfit.core import parallel
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.frequency_response import DOUBTED, LawTest, ResponseComparison
from rotorfit.core.laws import Structure, structure_named
from rotorfit.core.model import COEFFICIENTS, NORMAL, Axis, Model, Predictor, laws_of_vehicle
from rotorfit.core.results import Motion
from rotorfit.dynamics.kinematics import motion_from_flight
from rotorfit.dynamics.transfer_function import has_transfer_function, law_phase, law_response


def response_test(model: Model, flights: Sequence[Flight]) -> tuple[dict[str, ResponseComparison], ...]:
    """Responses of the axes that a flight commands and the model knows, beside the model's, for each flight."""
    return tuple(_responses_of(model, flight) for flight in flights)


def _responses_of(model: Model, flight: Flight) -> dict[str, ResponseComparison]:
    """`response_test` of one flight."""
    axes = [
        axis
        for axis in AXES
        if model.axes[axis].predictor is not None
        and axis in flight.axes
        and np.ptp(flight.command[:, AXES.index(axis)]) > 0
    ]
    motion = motion_from_flight(flight) if axes else None
    found = parallel.each(lambda axis: compared(model, flight, axis, motion), axes, flight.duration)
    return dict(zip(axes, found, strict=True))


def compared(model: Model, flight: Flight, axis: str, motion: Motion | None = None) -> ResponseComparison:
    """The response of one axis on one flight beside that of a model that knows the axis.

    Args:
        model: The model.
        flight: The flight.
        axis: Name of the axis.
        motion: The motion of the flight, where several axes share it; None computes it.
    """
    bands, instrument, why = response_bands(flight, axis, motion)
    measured, known = response_of_bands(axis, bands, instrument, why), model.axes[axis]
    structure, point = structure_named(known.structure), known.predictor
    if point is None or not has_transfer_function(structure) or not measured.frequency.size:
        return ResponseComparison(measured)
    modelled = law_response(structure, point, measured.frequency)
    measured = replace(measured, expected=law_phase(structure, point, measured.frequency))
    gain, delay = model_bands(model, axis, measured.frequency)
    return ResponseComparison(measured, modelled, gain, delay, law_test(bands, structure, point))


# The model's own band


def model_bands(model: Model, axis: str, omega: Array) -> tuple[Array, Array]:
    """95 % bands of a model's gain (K, 2), and half widths of those of its delay (K,) [s]; NaN without a covariance.

    As the intervals of the coefficients, they cover every law that the axis may have.
    """
    known = model.axes[axis]
    structure, point = structure_named(known.structure), known.predictor
    assert point is not None
    covariance = _covariance(model, axis, structure, known)
    if covariance is None:
        return np.full((omega.size, 2), np.nan), np.full(omega.size, np.nan)
    laws = [(structure, point, covariance)]
    for law in laws_of_vehicle(model, axis)[1:]:
        other = structure_named(law.structure)
        scale = _scale(other, law.predictor, list(law.stderr))
        laws.append((other, law.predictor, law.covariance * np.outer(scale, scale)))
    bands = [_band(*law, omega) for law in laws]
    gain = [np.exp([size - half, size + half]) for size, half, _, _ in bands]
    late = [np.abs(phase - bands[0][2]) + half for _, _, phase, half in bands]
    ends = np.stack([np.min([low for low, _ in gain], axis=0), np.max([high for _, high in gain], axis=0)], axis=1)
    return ends, np.max(late, axis=0) / omega


def _band(structure: Structure, point: Predictor, covariance: Array, omega: Array) -> tuple[Array, Array, Array, Array]:
    """Log gain and phase of a law, each with the half width of its 95 % interval by the delta method, (K,) each."""
    at = coordinates(structure, point)
    step = 1e-5 * np.eye(at.size)
    moved = [
        np.log(law_response(structure, point_at(structure, point, at + d), omega)
               / law_response(structure, point_at(structure, point, at - d), omega)) / 2e-5
        for d in step
    ]  # fmt: skip
    slope = np.stack(moved, axis=1)
    half, turn = (
        NORMAL * np.sqrt(np.maximum(np.einsum("kp,pq,kq->k", part, covariance, part), 0.0))
        for part in (slope.real, slope.imag)
    )
    return np.log(np.abs(law_response(structure, point, omega))), half, law_phase(structure, point, omega), turn


def _covariance(model: Model, axis: str, structure: Structure, known: Axis) -> Array | None:
    """Covariance of the coordinates; parameters missing from the model's covariance enter by their standard errors."""
    point, names = known.predictor, list(model.covariance_names)
    assert point is not None
    wanted = [*COEFFICIENTS[: 2 + structure.delayed], *(one.name for one in structure.extras if one.estimated)]
    scale = _scale(structure, point, wanted)
    out = np.zeros((len(wanted),) * 2)
    for i, first in enumerate(wanted):
        for j, second in enumerate(wanted):
            if f"{axis}.{first}" in names and f"{axis}.{second}" in names:
                out[i, j] = model.covariance[names.index(f"{axis}.{first}"), names.index(f"{axis}.{second}")]
        if f"{axis}.{first}" not in names:
            error = known.stderr.get(first)
            if error is None:
                return None
            out[i, i] = error**2
    return out * np.outer(scale, scale)


def _scale(structure: Structure, point: Predictor, names: Sequence[str]) -> Array:
    """Derivatives of the coordinates of some parameters with respect to their values, in the order of the names."""
    logs = {one.name: one.logarithmic for one in structure.extras}
    values = {"input": point.input, "damping": max(point.damping, SLOWEST), "delay": 1.0, **point.extra}
    return np.array([1 / abs(values[n]) if logs.get(n, n in ("input", "damping")) else 1.0 for n in names])


# Findings


def combined(tests: Sequence[LawTest]) -> float:
    """p-value of several flights together, by Fisher's method."""
    from scipy.special import chdtrc

    return float(chdtrc(2 * len(tests), -2 * sum(np.log(max(test.p, 1e-300)) for test in tests)))


def findings_of_responses(comparisons: Sequence[Mapping[str, ResponseComparison]]) -> Iterator[Finding]:
    """Findings from the responses of some flights, at most one per axis: a warning, or below `DOUBTED` an info.

    The p-value counts all frequencies and flights of an axis.
    """
    for axis in AXES:
        mine = [each[axis] for each in comparisons if axis in each]
        tests = [each.law for each in mine if each.law]
        if not tests or (p := combined(tests)) >= DOUBTED:
            continue
        each = max((one for one in mine if one.law), key=lambda one: one.law.worst_sigmas if one.law else 0.0)
        assert each.law is not None
        where = int(np.argmin(np.abs(each.flight.frequency - each.law.worst)))
        low, high = each.flight.gain_band[where]
        early, late = each.flight.delay_band[where]
        lasting = f"{np.pi / each.law.worst:.2g} s"
        yield Finding(
            "response_refutes_law",
            "warning" if p < FINDING_LEVEL else "info",
            f"{'no' if p < FINDING_LEVEL else 'hardly any'} coefficients give the law of {axis} the frequency response "
            f"of {'the flight' if len(tests) == 1 else 'the flights'} (p = {p:.1g}); largest deviation at "
            f"{each.law.worst:.2g} rad/s, where the flight has gain {low:.3g} to {high:.3g} and delay "
            f"{1e3 * early:.0f} to {1e3 * late:.0f} ms, the model {each.model_gain[where]:.3g} and "
            f"{1e3 * each.model_delay[where]:.0f} ms",
            f"gain and delay of {axis} depend on the frequencies that were flown, and its coefficients with them",
            f"use the model for motion like that of its flights; for commands that last about {lasting} fit "
            f"{'this flight' if len(tests) == 1 else 'these flights'} together with those of the model, or try "
            "--structure auto",
            axis,
        )


def response_mapping(comparison: ResponseComparison) -> dict[str, Any]:
    """One axis of one flight in plain types; unknown numbers are None."""
    flight, law = comparison.flight, comparison.law
    return {
        "instrument": flight.instrument,
        "why_none": flight.why_none or None,
        "frequency": flight.frequency.tolist(),
        "gain": flight.gain.tolist(),
        "gain_ci95": _pairs(flight.gain_band),
        "delay": flight.delay.tolist(),
        "delay_ci95": _pairs(flight.delay_band),
        "coherence": flight.coherence.tolist(),
        "model_gain": comparison.model_gain.tolist() or None,
        "model_gain_ci95": _pairs(comparison.gain_band) or None,
        "model_delay": comparison.model_delay.tolist() or None,
        "model_delay_ci95": _pairs(comparison.model_delay_band) or None,
        "law_p": None if law is None else law.p,
        "law_statistic": None if law is None else law.statistic,
        "law_freedom": None if law is None else law.freedom,
        "law_worst_frequency": None if law is None else law.worst,
        "law_worst_sigmas": None if law is None else law.worst_sigmas,
    }


def _pairs(band: Array) -> list[list[float | None]]:
    return [[float(end) if np.isfinite(end) else None for end in pair] for pair in band]
