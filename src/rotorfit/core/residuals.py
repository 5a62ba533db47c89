"""Innovations of a model on a flight, their correlations, and their tests."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rotorfit.core.display import short_repr
from rotorfit.core.frames import Array


@dataclass(frozen=True)
class Innovations:
    """Standardised one-step innovations of an axis on one flight, for B blocks of poses.

    Attributes:
        time: Shape (B,) [s].
        innovation: Shape (B,): white and of unit variance if the model is right.
        past: Command of the axis k blocks before, for k = 1 ... L, up to one second, shape (B, L).
        sensitivity: Negative derivative of the innovations with respect to input, log damping, delay and further
            parameters of the law, with the part that trim and initial state can absorb removed, shape (B, P).
    """

    time: Array
    innovation: Array
    past: Array
    sensitivity: Array

    __repr__ = short_repr


@dataclass(frozen=True)
class Correlogram:
    """Correlations over the lag, each with its own 95 % band.

    Attributes:
        lag: Shape (L,) [s].
        value: Shape (L,).
        band: Half width of each band, shape (L,): wider where the variance changes or neighbours are correlated.
    """

    lag: Array
    value: Array
    band: Array

    __repr__ = short_repr


@dataclass(frozen=True)
class ResidualTests:
    """The tests of one axis on one flight.

    Attributes:
        n: Number of innovations.
        lags: Number of lags, up to one second, in the test of whiteness.
        ljung_box: Classic Ljung-Box statistic, chi-squared with `lags` degrees of freedom if the innovations are white.
        ljung_box_p: Its p-value.
        white_p: p-value of the test that allows the variance to change during the flight; the verdict uses this one.
        command_freedom: Number of independent past commands, up to one second, in the second test.
        command_p: p-value of independence from the past commands; None where the axis was not commanded, or where the
            coefficients are too uncertain for a test.
        command_peak: Largest correlation with a past command, in units of its 95 % band.
        command_peak_lag: Lag of that correlation [s].
        variance_ratio: Mean square of the innovations at the levels of the fit; 1 if wind and noise equal those of the
            fit.
        variance_ci95: Its 95 % interval, including the uncertainty of the levels.
        optimism: Coefficient name to the factor by which its interval would be too narrow for such innovations.
        white: Whether whiteness is not rejected at 95 %.
        follows_command: Whether the innovations depend on past commands, at 95 %; None where that was not tested.
        own_p: `command_p` where the axis has the parameters of this flight, by one linear step; None where it was not
            asked, for the innovations are independent.
        own_step: Coefficient name to the step: input as a share of the model's, logarithm of the damping, delay [s].
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
    own_p: float | None = None
    own_step: Mapping[str, float] = field(default_factory=dict)


def told_p(p: float) -> str:
    """A p-value as text; below 1e-12 no approximation of the tail is worth a digit."""
    return f"p = {p:.2g}" if p >= 1e-12 else "p < 1e-12"
