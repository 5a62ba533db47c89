"""The law of an axis in the frequency domain: velocity per command.

With s = i w, gain g, damping b, delay tau, lag T and zero Z,

    H(s) = g exp(-s tau) / ((s + b) (1 + s T))                first-order lag of the attitude loop; T = 0 without one
    H(s) = g exp(-s tau) (1 + s Z) / (T s^2 + s + b)          second order; Z = 0 without a zero

Laws that are not linear, or that couple the axes, have no such function.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorfit.core.errors import ModelError
from rotorfit.core.frames import Array
from rotorfit.core.frequency_response import Spectrum
from rotorfit.core.laws import LAG, ZERO, Structure
from rotorfit.core.model import Predictor


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


def law_phase(structure: Structure, point: Predictor, omega: Array) -> Array:
    """Phase of a law, continuous from zero at rest whatever the sign of its input, in the shape of omega [rad].

    Without its delay a law turns by less than half a turn. Arguments and errors as for `law_response`.
    """
    at_once = law_response(structure, replace(point, input=abs(point.input), delay=0.0), omega)
    late = point.delay if structure.delayed else 0.0
    return np.asarray(np.angle(at_once) - late * np.asarray(omega, float), np.float64)
