"""Innovations of a model on a flight, their correlations, and the tests of them."""

from collections.abc import Mapping
from dataclasses import dataclass

from rotorfit.core.display import short_repr
from rotorfit.core.frames import Array


@dataclass(frozen=True)
class Innovations:
    """One-step innovations of an axis on one flight, standardised. B blocks of poses.

    Attributes:
        time: Shape (B,) [s].
        innovation: Shape (B,): white and of unit variance where the model is right.
        past: The command of the axis k blocks before, for k = 1 ... L, up to a second back, shape (B, L).
        sensitivity: Change of the innovations by -1 times a change of input, log damping and delay, as far as trim and
            start cannot make up for it, shape (B, 3).
    """

    time: Array
    innovation: Array
    past: Array
    sensitivity: Array

    __repr__ = short_repr


@dataclass(frozen=True)
class Correlogram:
    """Correlations over the lag with 95 % bands of their own.

    Attributes:
        lag: Shape (L,) [s].
        value: Shape (L,).
        band: Half width of the band of each, shape (L,): wider where the variance changes or neighbours go together.
    """

    lag: Array
    value: Array
    band: Array

    __repr__ = short_repr


@dataclass(frozen=True)
class ResidualTests:
    """The tests of one axis on one flight.

    Attributes:
        n: Innovations.
        lags: How many lags, up to a second, the test of whiteness takes.
        ljung_box: Its classic statistic, chi-squared with `lags` degrees of freedom if the innovations are white.
        ljung_box_p: p-value of it.
        white_p: The same where the variance may change during the flight: what the verdict takes.
        command_freedom: How many independent past commands, up to a second back, the second test takes.
        command_p: p-value of the innovations not following them; None where the axis was not commanded.
        command_peak: Largest correlation with a past command, in units of its 95 % band.
        command_peak_lag: Its lag [s].
        variance_ratio: Mean square of the innovations with the levels of the fit; 1 if wind and noise are those of
            the fit.
        variance_ci95: Its 95 % interval, what the fit knows of its levels included.
        optimism: Coefficient name to the factor by which its interval would be too narrow for innovations like these.
        white: Whether nothing speaks against whiteness at 95 %.
        follows_command: Whether they follow the past commands, at 95 %; None where there were none.
    """

    n: int
    lags: int
    ljung_box: float
    ljung_box_p: float
    white_p: float
    command_freedom: int
    command_p: float | None
    command_peak: float | None
    command_peak_lag: float | None
    variance_ratio: float
    variance_ci95: tuple[float, float]
    optimism: Mapping[str, float]
    white: bool
    follows_command: bool | None
