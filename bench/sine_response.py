"""The response of an axis to a sine of its command, as a model states it: gain and phase delay with intervals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.laws import structure_named
from rotorfit.core.model import COEFFICIENTS, NORMAL, Interval, Model, Predictor, Weighed, predictor_of, weighed
from rotorfit.dynamics.transfer_function import law_phase, law_response

STEP = 1e-5
"""Relative step of the finite differences by a parameter."""


@dataclass(frozen=True)
class SineResponse:
    """Response of an axis's velocity to a sine of its command.

    Attributes:
        gain: Amplitude of the velocity over that of the command.
        delay: Phase delay, minus the phase over the frequency [s].
        gain_ci95: 95 % interval of the gain.
        delay_ci95: 95 % interval of the delay.
    """

    gain: float
    delay: float
    gain_ci95: Interval
    delay_ci95: Interval


def sine_response(model: Model, axis: str, frequency: float) -> SineResponse:
    """Gain and delay of an axis at a frequency [rad/s]; where several laws hold, intervals that cover all of them.

    Source: the delta method on log gain and on phase delay.
    """
    told = [_response(law, frequency) for law in model.axes[axis].laws or (_only(model, axis),)]
    gains, delays = [t.gain_ci95 for t in told], [t.delay_ci95 for t in told]
    return SineResponse(told[0].gain, told[0].delay, _around(gains), _around(delays))


def gain_and_delay(law: str, point: Predictor, frequency: float) -> tuple[float, float]:
    """Gain and phase delay [s]."""
    structure, at = structure_named(law), np.array([frequency])
    phase = float(law_phase(structure, point, at)[0])
    return abs(complex(law_response(structure, point, at)[0])), -phase / frequency


def _around(intervals: Sequence[Interval]) -> Interval:
    return min(low for low, _ in intervals if low is not None), max(high for _, high in intervals if high is not None)


def _only(model: Model, axis: str) -> Weighed:
    """The law of an axis whose structure was requested, with its covariance."""
    known, point = model.axes[axis], predictor_of(model, axis)
    names = [name for name in (*COEFFICIENTS, *point.extra) if f"{axis}.{name}" in model.covariance_names]
    at = [model.covariance_names.index(f"{axis}.{name}") for name in names]
    return weighed(known.structure, point, names, model.covariance[np.ix_(at, at)])


def _response(law: Weighed, frequency: float) -> SineResponse:
    here, late = gain_and_delay(law.structure, law.predictor, frequency)
    by_gain, by_delay = [], []
    for name in law.stderr:
        value = law.predictor.extra[name] if name in law.predictor.extra else getattr(law.predictor, name)
        step = STEP * max(abs(value), 1e-2)
        there, later = gain_and_delay(law.structure, _moved(law.predictor, name, value + step), frequency)
        by_gain.append(np.log(there / here) / step)
        by_delay.append((later - late) / step)
    spread, turn = (_half_width(np.array(slope), law.covariance) for slope in (by_gain, by_delay))
    return SineResponse(here, late, (here * np.exp(-spread), here * np.exp(spread)), (late - turn, late + turn))


def _half_width(slope: np.ndarray, covariance: np.ndarray) -> float:
    return NORMAL * float(np.sqrt(max(slope @ covariance @ slope, 0.0)))


def _moved(point: Predictor, name: str, value: float) -> Predictor:
    if name in point.extra:
        return replace(point, extra={**point.extra, name: value})
    return replace(point, **{name: value})
