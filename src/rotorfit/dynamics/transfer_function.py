"""The law of an axis in the frequency domain: velocity per command, and the response of an axis to a sine.

With s = i w, gain g, damping b, delay tau, lag T and zero Z,

    H(s) = g exp(-s tau) / ((s + b) (1 + s T))                first-order lag of the attitude loop; T = 0 without one
    H(s) = g exp(-s tau) (1 + s Z) / (T s^2 + s + b)          second order; Z = 0 without a zero

Laws that are not linear, or that couple the axes, have no such function.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.errors import ModelError
from rotorfit.core.frames import Array
from rotorfit.core.frequency_response import Spectrum
from rotorfit.core.laws import LAG, ZERO, Structure, structure_named
from rotorfit.core.model import COEFFICIENTS, NORMAL, Interval, Model, Predictor, Weighed, predictor_of, weighed

STEP = 1e-5
"""Relative step of the finite differences by a parameter."""


@dataclass(frozen=True)
class SineResponse:
    """Response of an axis's velocity to a sine of its command.

    Attributes:
        frequency: Frequency [rad/s].
        gain: Amplitude of the velocity over that of the command.
        delay: Phase delay, minus the phase over the frequency [s].
        gain_ci95: 95 % interval of the gain.
        delay_ci95: 95 % interval of the delay.
    """

    frequency: float
    gain: float
    delay: float
    gain_ci95: Interval
    delay_ci95: Interval


def has_transfer_function(structure: Structure) -> bool:
    """Whether the response of the law to a sine is a sine of the same frequency on the same axis only."""
    return structure.linear and not structure.kicks


def law_response(structure: Structure, point: Predictor, omega: Array) -> Spectrum:
    """Velocity per command of a law, in the shape of omega.

    Args:
        structure: A law with a transfer function.
        point: Its parameters.
        omega: Frequencies, positive [rad/s].

    Raises:
        ModelError: The law has no transfer function.
    """
    if not has_transfer_function(structure):
        raise ModelError(f"the law {structure.name} is not linear and has no frequency response; fit a linear one")
    s = 1j * np.asarray(omega, float)
    extra: Mapping[int, float] = {one.place: point.extra[one.name] for one in structure.extras}
    lag, delay = extra.get(LAG, 0.0), point.delay if structure.delayed else 0.0
    poles = lag * s**2 + s + point.damping if structure.order == 2 else (s + point.damping) * (1 + s * lag)
    return np.asarray(point.input * np.exp(-s * delay) * (1 + s * extra.get(ZERO, 0.0)) / poles)


def sine_response(model: Model, axis: str, frequency: float) -> SineResponse:
    """Gain and delay of an axis at a frequency [rad/s]; where several laws hold, intervals that cover all of them.

    Raises:
        ModelError: The axis was not excited, or its law is not linear.

    Source: the delta method on log gain and on phase.
    """
    known = model.axes[axis]
    laws = known.laws or (_only(model, axis),)
    told = [_response(law, frequency) for law in laws]
    gains, delays = [t.gain_ci95 for t in told], [t.delay_ci95 for t in told]
    return SineResponse(frequency, told[0].gain, told[0].delay, _around(gains), _around(delays))


def _around(intervals: Sequence[Interval]) -> Interval:
    return min(low for low, _ in intervals if low is not None), max(high for _, high in intervals if high is not None)


def _only(model: Model, axis: str) -> Weighed:
    """The law of an axis whose structure was requested, with its covariance."""
    known, point = model.axes[axis], predictor_of(model, axis)
    names = [name for name in (*COEFFICIENTS, *point.extra) if f"{axis}.{name}" in model.covariance_names]
    at = [model.covariance_names.index(f"{axis}.{name}") for name in names]
    return weighed(known.structure, point, names, model.covariance[np.ix_(at, at)])


def _response(law: Weighed, frequency: float) -> SineResponse:
    structure, w = structure_named(law.structure), np.array([frequency])

    def logarithm(point: Predictor) -> complex:
        return complex(np.log(law_response(structure, point, w))[0])

    here, slopes = logarithm(law.predictor), []
    for name in law.stderr:
        value = law.predictor.extra[name] if name in law.predictor.extra else getattr(law.predictor, name)
        step = STEP * max(abs(value), 1e-2)
        slopes.append((logarithm(_moved(law.predictor, name, value + step)) - here) / step)
    slope, covariance = np.array(slopes), law.covariance
    spread = NORMAL * float(np.sqrt(max(slope.real @ covariance @ slope.real, 0.0)))
    turn = NORMAL * float(np.sqrt(max(slope.imag @ covariance @ slope.imag, 0.0))) / frequency
    gain, delay = float(np.exp(here.real)), -here.imag / frequency
    return SineResponse(
        frequency, gain, delay, (gain * np.exp(-spread), gain * np.exp(spread)), (delay - turn, delay + turn)
    )


def _moved(point: Predictor, name: str, value: float) -> Predictor:
    numbers = {"input": point.input, "damping": point.damping, "delay": point.delay}
    extra = dict(point.extra)
    (extra if name in extra else numbers)[name] = value
    return Predictor(numbers["input"], numbers["damping"], numbers["delay"], extra)
