"""FrequencyResponse of a flight, compared with the model's, and the test of a law against it."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from rotorfit.core.frames import Array

Spectrum = npt.NDArray[np.complex128]

Instrument = Literal["command", "tones", "reference", "none"]


DOUBTED = 0.01
"""p-value below which a flight doubts the law of an axis: on one in twenty-five flights of four axes by chance."""

KNOTS = 4
"""Number of lowest frequencies whose line of phases tells how many half turns the phase at rest is off."""


@dataclass(frozen=True)
class FrequencyResponse:
    """Frequency response of one axis on one flight at K frequencies; K = 0 where it cannot be estimated.

    Attributes:
        axis: `x`, `y`, `z` or `yaw`.
        frequency: Increasing, shape (K,) [rad/s].
        response: Complex velocity per command, shape (K,) [m/s or rad/s per unit of the command].
        stderr: Standard errors of the gain, and of gain times phase, shape (K, 2).
        quantile: 97.5 % point of Student's t for the degrees of freedom of the standard errors, shape (K,).
        coherence: Share of the motion's power that the command explains at each frequency, shape (K,).
        instrument: Signal that excites the vehicle from outside any loop: `tones` of the command; the whole `command`
            in an open loop; else the `reference`; `none`.
        why_none: Why there is no response; empty where there is one.
        expected: Phase of a model, which tells the whole turns of the response, shape (K,) [rad]; empty without one.
    """

    axis: str
    frequency: Array
    response: Spectrum
    stderr: Array
    quantile: Array
    coherence: Array
    instrument: Instrument
    why_none: str = ""
    expected: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def gain(self) -> Array:
        """Magnitude of the response, shape (K,)."""
        return np.asarray(np.abs(self.response), np.float64)

    @property
    def gain_band(self) -> Array:
        """Ends of the 95 % bands of the gain, not below 0, shape (K, 2)."""
        half = self.quantile * self.stderr[:, 0]
        return np.asarray(np.stack([np.maximum(self.gain - half, 0), self.gain + half], axis=1), np.float64)

    @property
    def phase(self) -> Array:
        """Phase nearest to the expected one, or else unwrapped and shifted by half turns into a lag, shape (K,) [rad].

        Half turns, because the sign of the input must not change the delay of the response. A line through the phases
        of a slow vehicle, far above its damping, begins a quarter turn below zero: lags to three eighths of a turn are
        taken as such, and leads to one eighth.
        """
        if self.expected.size:
            sign = np.sign(np.sum((self.response * np.exp(-1j * self.expected)).real)) or 1.0
            off = np.angle(sign * self.response * np.exp(-1j * self.expected))
            return np.asarray(self.expected + off, np.float64)
        phase = np.asarray(np.unwrap(np.angle(self.response)), np.float64)
        w = self.frequency
        at_rest = phase[:1].sum()
        if w.size > 1:  # by the errors of the phases: a noisy one at the lowest frequency must not decide alone
            near = slice(0, KNOTS)
            certainty = self.gain[near] / np.maximum(self.stderr[near, 1], 1e-12)
            at_rest = np.polynomial.polynomial.polyfit(w[near], phase[near], 1, w=certainty)[0]
        return np.asarray(phase - np.pi * np.round(at_rest / np.pi + 0.25), np.float64)

    @property
    def delay(self) -> Array:
        """Phase delay -phase / frequency, shape (K,) [s]."""
        return np.asarray(-self.phase / self.frequency)

    @property
    def delay_band(self) -> Array:
        """Ends of the 95 % bands of the delay, shape (K, 2) [s]; infinite where the phase is undetermined."""
        ratio = self.quantile * self.stderr[:, 1] / self.gain
        half = np.where(ratio < 1, np.arcsin(np.minimum(ratio, 1)), np.inf) / self.frequency
        return np.stack([self.delay - half, self.delay + half], axis=1)


@dataclass(frozen=True)
class LawTest:
    """Test whether a law is compatible with the measured response of a flight.

    Attributes:
        statistic: Q over its degrees of freedom: about 1 for noise alone.
        freedom: Real numbers in the bands less free coefficients.
        p: p-value of the law.
        worst: Frequency of the largest misfit, by the 95 % bands [rad/s].
        worst_sigmas: That misfit in standard errors, which few degrees of freedom may make small.
        worst_share: That misfit over the half width of the 95 % band.
    """

    statistic: float
    freedom: int
    p: float
    worst: float
    worst_sigmas: float
    worst_share: float


@dataclass(frozen=True)
class ResponseComparison:
    """The measured response of an axis on one flight compared with the model's.

    Attributes:
        flight: The response measured on the flight.
        model: The model's response at the same frequencies, shape (K,); None where its law has none.
        gain_band: Ends of the 95 % bands of the model's gain, shape (K, 2); NaN where unknown.
        delay_half_width: Half widths of the 95 % bands of the model's delay, shape (K,) [s]; NaN where unknown.
        law: Test of the law; None without a response, or with no more numbers than coefficients.
    """

    flight: FrequencyResponse
    model: Spectrum | None = None
    gain_band: Array = field(default_factory=lambda: np.zeros((0, 2)))
    delay_half_width: Array = field(default_factory=lambda: np.zeros(0))
    law: LawTest | None = None

    @property
    def model_gain(self) -> Array:
        """Magnitude of the model's response, shape (K,)."""
        return np.zeros(0) if self.model is None else np.abs(self.model)

    @property
    def model_delay(self) -> Array:
        """Phase delay of the model, shape (K,) [s]."""
        return np.zeros(0) if self.model is None else -self.flight.expected / self.flight.frequency

    @property
    def model_delay_band(self) -> Array:
        """Ends of the 95 % bands of the model's delay, shape (K, 2) [s]; infinite where the phase is undetermined."""
        if self.model is None:
            return np.zeros((0, 2))
        half = np.where(self.delay_half_width * self.flight.frequency < np.pi, self.delay_half_width, np.inf)
        return np.stack([self.model_delay - half, self.model_delay + half], axis=1)
