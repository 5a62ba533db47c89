"""Accuracy: what is known about the uncertainty of a fit, as the model file keeps it."""

from collections.abc import Mapping
from dataclasses import dataclass

COEFFICIENT_ERROR_LIMIT = 20.0
"""Standard error in per cent of the value beyond which a coefficient is marked."""

INSENSITIVITY_LIMIT = 10.0
"""Insensitivity in per cent beyond which a coefficient is marked: the fit hardly feels it, whatever the others do."""

CORRELATION_LIMIT = 0.9
"""Correlation of two estimates beyond which they are marked as one."""


@dataclass(frozen=True)
class Accuracy:
    """One coefficient: five standard errors, and how they compare with its value.

    Attributes:
        value: The estimate, as in the predictor.
        expected: Standard error from the expected information (Cramer-Rao).
        observed: From the observed information, by differences of the score; None where that has no maximum here.
        ragged: Whether the observed one depends on the step of the differences, and is not to be relied on.
        sandwich: From the scatter of the score itself, autocorrelation allowed for.
        bootstrap: From drawn flights; None where they were not asked for.
        scatter: The expected one, widened by how much the flights disagree; None for fewer than two flights.
        percent: The expected one in per cent of the value; None where the value is 0.
        insensitivity: 100 / (|value| sqrt(F)), F the information about this coefficient alone, in per cent.
        disturbance: Largest correlation with a level of the disturbance, from the observed information; None as there.
    """

    value: float
    expected: float
    observed: float | None
    ragged: bool
    sandwich: float
    bootstrap: float | None
    scatter: float | None
    percent: float | None
    insensitivity: float | None
    disturbance: float | None


@dataclass(frozen=True)
class FlightEstimate:
    """What one flight alone says, the levels of the disturbance being those of all.

    Attributes:
        flight: Its place among the model's flights.
        value: Coefficient name to estimate.
        stderr: Coefficient name to standard error.
    """

    flight: int
    value: Mapping[str, float]
    stderr: Mapping[str, float]


@dataclass(frozen=True)
class Scatter:
    """How the flights that serve an axis agree.

    Attributes:
        flights: What each says alone.
        mean: Coefficient name to weighted mean (of the damping: in its logarithm).
        cochran: Coefficient name, and `steady_gain` and `total_lag` of the default structure, to Cochran's Q:
            chi-square of one less than the flights where they agree.
        i_squared: The same to the share of the scatter that is more than chance.
        factor: Coefficient name to how many times more it scatters among flights than its error says, at least 1. For
            a coefficient alone it is sqrt(Q / (flights - 1)); it holds, too, where no flight tells two of them apart.
        ratio: Twice the log-likelihood that coefficients of their own would gain the flights.
        freedom: Degrees of freedom of it.
        p_value: How often flights that agree give as much.
    """

    flights: tuple[FlightEstimate, ...]
    mean: Mapping[str, float]
    cochran: Mapping[str, float]
    i_squared: Mapping[str, float]
    factor: Mapping[str, float]
    ratio: float
    freedom: int
    p_value: float


@dataclass(frozen=True)
class Inseparable:
    """Two coefficients whose estimates move together, and what is known of them all the same.

    Attributes:
        pair: Their names.
        correlation: Of the estimates.
        combination: Name among the axis's combinations of what the data do tell; None where that is no better known.
        value: Of the combination.
        ci95: Its 95 % interval.
    """

    pair: tuple[str, str]
    correlation: float
    combination: str | None = None
    value: float | None = None
    ci95: tuple[float, float] | None = None


@dataclass(frozen=True)
class AxisAccuracy:
    """The accuracy table of one axis.

    Attributes:
        coefficients: Coefficient name to its five standard errors.
        correlation: Of (input, damping, delay), from the expected information, 3 rows of 3.
        inseparable: Pairs that are correlated beyond the limit.
        scatter: How its flights agree; None for fewer than two.
    """

    coefficients: Mapping[str, Accuracy]
    correlation: tuple[tuple[float, ...], ...]
    inseparable: tuple[Inseparable, ...]
    scatter: Scatter | None


@dataclass(frozen=True)
class Uncertainty:
    """The accuracy table of a fit.

    Attributes:
        axes: Axis name to its table, for axes with a predictor.
        observed_step: Step of the differences of the score, in expected standard errors.
        bootstrap_flights: Flights drawn, and the seed of the draws.
        bootstrap_seed: See there.
        bootstrap_block: Length of the blocks of innovations that are drawn [s].
        sandwich_lag: Lag up to which the scores count as correlated [s].
    """

    axes: Mapping[str, AxisAccuracy]
    observed_step: float
    bootstrap_flights: int
    bootstrap_seed: int
    bootstrap_block: float
    sandwich_lag: float


@dataclass(frozen=True)
class PriorUse:
    """What the card's prior did to one coefficient.

    Attributes:
        mean: Of the prior.
        sd: Of the prior; of the damping it stands for the share sd / mean of a normal logarithm.
        data: What the flights alone say.
        moved: How far the prior moved the estimate, in standard errors of the flights alone.
        share: Of the information about the coefficient that is the prior's, 0 to 1.
        conflict: Distance of the two in combined standard errors.
    """

    mean: float
    sd: float
    data: float
    moved: float
    share: float
    conflict: float
