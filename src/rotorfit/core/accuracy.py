"""Accuracy: the uncertainty of a fit, as the model file stores it."""

from collections.abc import Mapping
from dataclasses import dataclass

COEFFICIENT_ERROR_LIMIT = 20.0
"""Standard error in per cent of the value above which a coefficient is marked."""

INSENSITIVITY_LIMIT = 10.0
"""Insensitivity in per cent above which a coefficient is marked: the fit hardly depends on it."""

CORRELATION_LIMIT = 0.9
"""Absolute correlation of two estimates above which the pair is marked as inseparable."""


@dataclass(frozen=True)
class Accuracy:
    """Standard errors of one coefficient by five methods, and their size relative to its value.

    Attributes:
        value: Estimate, as in the predictor.
        expected: Standard error from the expected information (Cramer-Rao).
        observed: Standard error from the observed information, by finite differences of the score; None where the
            log-likelihood has no maximum here, as at a bound of the search.
        ragged: Whether `observed` is unreliable: it depends on the step of the differences, or another coefficient of
            the axis was held at a bound.
        sandwich: Standard error from the scatter of the score itself, allowing for autocorrelation.
        bootstrap: Standard error from resampled flights; None where the estimate, or too many of those of the resampled
            flights, are at a bound of the search.
        scatter: `expected`, widened by the disagreement of the flights; None for fewer than two flights.
        percent: `expected` in per cent of the value; None where the value is 0.
        insensitivity: 100 / (|value| sqrt(F)), F the information about this coefficient alone, in per cent.
        disturbance: Largest correlation with a disturbance level, from the observed information; None like `observed`.
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
    """Estimates from one flight alone, with the disturbance levels of the joint fit.

    Attributes:
        flight: Index of the flight in the model's list.
        value: Coefficient name to estimate.
        stderr: Coefficient name to standard error.
    """

    flight: int
    value: Mapping[str, float]
    stderr: Mapping[str, float]


@dataclass(frozen=True)
class Scatter:
    """Agreement of the flights that contribute to an axis.

    Attributes:
        flights: Estimates from each flight alone.
        mean: Coefficient name to weighted mean (for the damping: of its logarithm).
        cochran: Coefficient name, and `steady_gain` and `total_lag` of the default structure, to Cochran's Q:
            chi-squared with one degree of freedom fewer than flights if they agree.
        i_squared: The same names to the share of the scatter that exceeds chance.
        factor: Coefficient name to the ratio of its scatter among flights to its standard error, at least 1. For a
            single coefficient it is sqrt(Q / (flights - 1)); it is also defined where no flight separates two of them.
        ratio: Twice the log-likelihood gained by giving each flight its own coefficients.
        freedom: Degrees of freedom of `ratio`.
        p_value: Probability of a ratio at least this large if the flights agree.
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
    """Two coefficients whose estimates are strongly correlated, and the combination that is still identifiable.

    Attributes:
        pair: Their names.
        correlation: Correlation of the two estimates.
        combination: Name of the axis's combination that the data do identify; None where it is no better known.
        value: Value of the combination.
        ci95: 95 % interval of the combination.
    """

    pair: tuple[str, str]
    correlation: float
    combination: str | None = None
    value: float | None = None
    ci95: tuple[float, float] | None = None


@dataclass(frozen=True)
class AxisAccuracy:
    """The accuracy table of one axis: of the flights of the fit and of the leading law alone.

    Attributes:
        coefficients: Name of each coefficient, then of each further parameter of the law, to its five standard errors.
        correlation: Correlation of these, from the expected information, a row for each.
        inseparable: Pairs whose correlation exceeds the limit.
        scatter: Agreement of the flights; None for fewer than two.
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
        bootstrap_flights: Number of flights drawn.
        bootstrap_seed: Seed of the draws.
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
    """Effect of the card's prior on one coefficient.

    Attributes:
        mean: Mean of the prior.
        sd: Standard deviation of the prior; for the damping, sd / mean is that of its normally distributed logarithm.
        data: Estimate from the flights alone.
        moved: Shift of the estimate by the prior, in standard errors of the flights alone.
        share: Prior's share of the information about the coefficient, 0 to 1.
        conflict: Distance between prior and data in combined standard errors.
    """

    mean: float
    sd: float
    data: float
    moved: float
    share: float
    conflict: float
