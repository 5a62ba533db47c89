"""FrequencyResponse of a flight, the model's beside it, and the test of a law against it."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from rotorfit.core.frames import Array

Spectrum = npt.NDArray[np.complex128]

Instrument = Literal["command", "tones", "reference", "none"]


@dataclass(frozen=True)
class FrequencyResponse:
    """The response of one axis on one flight; K frequencies, none where it cannot be told.

    Attributes:
        axis: Name.
        frequency: Increasing, shape (K,) [rad/s].
        response: Velocity per command, shape (K,).
        stderr: Standard error of its gain, and of its phase times its gain, shape (K, 2).
        quantile: 97.5 % point of Student's t for the degrees of freedom that tell the standard error, shape (K,).
        coherence: Share of the motion's power that the command explains there, shape (K,).
        instrument: What moved the vehicle from outside any loop: `tones` of the command, in an open loop the whole
            `command`, else the `reference`; `none`.
        why_none: Where there is no response, why.
    """

    axis: str
    frequency: Array
    response: Spectrum
    stderr: Array
    quantile: Array
    coherence: Array
    instrument: Instrument
    why_none: str = ""

    @property
    def gain(self) -> Array:
        """Shape (K,)."""
        return np.asarray(np.abs(self.response), np.float64)

    @property
    def gain_band(self) -> Array:
        """Ends of the 95 % bands of the gain, shape (K, 2)."""
        half = self.quantile * self.stderr[:, 0]
        return np.asarray(np.stack([np.maximum(self.gain - half, 0), self.gain + half], axis=1), np.float64)

    @property
    def phase(self) -> Array:
        """Continuous over the frequency, and as near to zero at rest as whole turns make it, shape (K,) [rad].

        Half turns where the input is negative: the delay is that of the answer, whatever its sign.
        """
        phase = np.asarray(np.unwrap(np.angle(self.response)), np.float64)
        w = self.frequency
        at_rest = phase[0] - w[0] * (phase[1] - phase[0]) / (w[1] - w[0]) if w.size > 1 else phase[:1].sum()
        return np.asarray(phase - np.pi * np.round(at_rest / np.pi), np.float64)

    @property
    def delay(self) -> Array:
        """By which a sine of that frequency comes later, -phase / frequency, shape (K,) [s]."""
        return np.asarray(-self.phase / self.frequency)

    @property
    def delay_band(self) -> Array:
        """Ends of its 95 % bands, shape (K, 2) [s]; infinite where the phase can be anything."""
        ratio = self.quantile * self.stderr[:, 1] / self.gain
        half = np.where(ratio < 1, np.arcsin(np.minimum(ratio, 1)), np.inf) / self.frequency
        return np.stack([self.delay - half, self.delay + half], axis=1)


@dataclass(frozen=True)
class LawTest:
    """Whether a law can have the response that a flight shows.

    Attributes:
        statistic: Q over its degrees of freedom: 1 is about what noise gives.
        freedom: Real numbers that the bands tell less coefficients that were free.
        noise_freedom: Of the F distribution's denominator.
        p: p-value of the law.
        worst: Frequency at which the law misses the band most [rad/s].
        worst_sigmas: By how many standard errors.
    """

    statistic: float
    freedom: int
    noise_freedom: float
    p: float
    worst: float
    worst_sigmas: float


@dataclass(frozen=True)
class ResponseComparison:
    """The response of an axis on one flight beside the model's.

    Attributes:
        flight: The flight's own response.
        model: The model's at the same frequencies, shape (K,); None where its law has none.
        gain_band: Ends of the 95 % bands of the model's gain, shape (K, 2); NaN where they are not known.
        delay_band: The same of its delay [s].
        law: Test of the law; None where there are no more numbers than coefficients, or no response.
    """

    flight: FrequencyResponse
    model: Spectrum | None = None
    gain_band: Array = field(default_factory=lambda: np.zeros((0, 2)))
    delay_band: Array = field(default_factory=lambda: np.zeros((0, 2)))
    law: LawTest | None = None

    @property
    def model_gain(self) -> Array:
        """Shape (K,)."""
        return np.zeros(0) if self.model is None else np.abs(self.model)

    @property
    def model_delay(self) -> Array:
        """Of the model's phase nearest to the flight's, shape (K,) [s]."""
        if self.model is None:
            return np.zeros(0)
        phase = self.flight.phase + np.angle(self.model / self.flight.response)
        return np.asarray(-phase / self.flight.frequency)
