"""What is known about the uncertainty of a fit: the nouns of the accuracy table, as the model file keeps them.

Model: coefficients with their uncertainty, disturbance levels, and where they come from; simulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rotorfit.core.card import Card
from rotorfit.core.errors import ModelError
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import FIRST_ORDER_DELAY
from rotorfit.core.limits import Conversion, Quantity
from rotorfit.version import __version__

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


COEFFICIENTS = ("input", "damping", "delay")

STRUCTURE = FIRST_ORDER_DELAY.name

Interval = tuple[float | None, float | None]


@dataclass(frozen=True)
class Combination:
    """A combination of coefficients that can be known when its parts cannot.

    Attributes:
        value: The estimate.
        ci95: Its 95 % interval; an open end is None.
    """

    value: float
    ci95: Interval


@dataclass(frozen=True)
class Predictor:
    """The likelihood's own point of an axis: what simulation and prediction use.

    Attributes:
        input: g.
        damping: b [1/s].
        delay: tau [s].
        extra: Further parameters of its structure by name.
    """

    input: float
    damping: float
    delay: float
    extra: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Candidate:
    """A structure that was tried for an axis, and how it compares with the one it had to beat.

    Attributes:
        structure: Name.
        parameters: How many it estimates for the axis.
        log_likelihood: Less that of the default structure.
        bic: Bayesian information criterion less that of the default structure, over `samples`.
        velocity: Held-out RMSE of 1 s velocity predictions [m/s or rad/s]; None where none could be made.
        position: Held-out RMSE of the end points of 5 s predictions [m or rad]; None likewise.
        rival: The structure that it had to beat; empty for the first.
        velocity_change: Mean of its squared velocity errors less the rival's, as a share of the rival's mean, and the
            standard error of that; None where there is none.
        position_change: The same of the squared end point errors.
        verdict: What follows, in a sentence.
        chosen: Whether the model has this one.
    """

    structure: str
    parameters: int
    log_likelihood: float
    bic: float
    velocity: float | None
    position: float | None
    rival: str
    velocity_change: tuple[float, float] | None
    position_change: tuple[float, float] | None
    verdict: str
    chosen: bool


@dataclass(frozen=True)
class Plain:
    """The default structure's coefficients of an axis that has another: what the paper's eight are compared with.

    Attributes:
        input: g.
        damping: b [1/s].
        delay: tau [s].
        stderr: Coefficient name to standard error.
        ci95: Coefficient name to 95 % interval.
        status: Coefficient name to status.
    """

    input: float | None
    damping: float | None
    delay: float | None
    stderr: Mapping[str, float | None]
    ci95: Mapping[str, Interval]
    status: Mapping[str, str]


@dataclass(frozen=True)
class Mode:
    """An optimum of the likelihood that the search found.

    Attributes:
        delay: [s].
        damping: [1/s].
        input: g.
        log_likelihood: Less that of the best optimum.
        starts: How many starts ended here.
        prediction: RMSE of 1 s velocity predictions on the training flights [unit/s]; None where it was not needed.
        chosen: Whether the model is this one.
    """

    delay: float
    damping: float
    input: float
    log_likelihood: float
    starts: int
    prediction: float | None
    chosen: bool


@dataclass(frozen=True)
class Axis:
    """What is known of one axis: a = input u(t - delay) - damping v.

    Attributes:
        input: g, in m/s^2 (yaw: rad/s^2) per unit of the command; None where the data cannot tell.
        damping: b [1/s].
        delay: tau [s].
        stderr: Coefficient name to standard error.
        ci95: Coefficient name to 95 % interval; an open end is None.
        status: Coefficient name to `ok`, `not_excited`, `not_identifiable`, `diverged` or `too_short`.
        trim: Constant acceleration in the heading frame, one per flight; None where a flight did not serve this axis.
        noise: `wind_power`, `pose_variance`, `wind_damping`, `wind_overlap` and `trim_variance` of the disturbance;
            `velocity_variance` beside or in place of that of the pose, where a velocity was measured.
        predictor: What simulation uses; None where the axis is not excited.
        combinations: `steady_gain` (g / b) and `total_lag` (delay, lag and 1 / b together) [s]; of other structures
            further ones; where the structure was chosen, `delay_plus_lag` [s] of `first_order_delay_lag`; of clocks
            whose offset is not known, `offset_plus_delay` [s] instead of `total_lag`.
        modes: Optima of the likelihood, the chosen one first.
        profile: Delays [s] and the log-likelihood, less its maximum, re-maximised over everything else at each.
        profile_fall: How far it falls to the ends of the delay's interval.
        structure: Name of its law.
        extra: Further parameters of that law, published as the coefficients are; their standard errors, intervals and
            statuses stand beside those of the coefficients.
        plain: Coefficients of the default structure where this one is another.
        candidates: Structures that were tried, where the structure was chosen.
        samples: Effective number of independent innovations that the candidates' criterion counts; None likewise.
    """

    input: float | None
    damping: float | None
    delay: float | None
    stderr: Mapping[str, float | None]
    ci95: Mapping[str, Interval]
    status: Mapping[str, str]
    trim: tuple[float | None, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    predictor: Predictor | None = None
    combinations: Mapping[str, Combination] = field(default_factory=dict)
    modes: tuple[Mode, ...] = ()
    profile: tuple[tuple[float, float], ...] = ()
    profile_fall: float | None = None
    structure: str = STRUCTURE
    extra: Mapping[str, float | None] = field(default_factory=dict)
    plain: Plain | None = None
    candidates: tuple[Candidate, ...] = ()
    samples: float | None = None


def unknown_axis(status: str) -> Axis:
    """An axis of which nothing is known, and why."""
    nothing = dict.fromkeys(COEFFICIENTS)
    return Axis(
        input=None,
        damping=None,
        delay=None,
        stderr=nothing,
        ci95=dict.fromkeys(COEFFICIENTS, (None, None)),
        status=dict.fromkeys(COEFFICIENTS, status),
    )


@dataclass(frozen=True)
class Source:
    """A flight that the model was fitted to.

    Attributes:
        path: As given.
        sha256: Of the log.
        span: Seconds of its common window.
        notes: Repairs.
        axes: The axes that it served.
    """

    path: str
    sha256: str
    span: tuple[float, float]
    notes: tuple[Note, ...] = ()
    axes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Model:
    """A fitted model.

    Attributes:
        card: The card that was applied.
        structure: Name of the model structure; `mixed` where the axes have different ones.
        method: `ml`, `robust`, `paper`, `svf`, `weak`, `iv` or `oe`.
        axes: Axis name to what is known of it, for all four axes.
        covariance_names: Rows of the covariance, such as `x.input`, over (input, damping, delay) of the excited axes.
        covariance: Shape (P, P).
        paper: gamma of the paper's method on the same data, shape (8,), None where it gives no number.
        findings: What the user should know.
        flights: What it was fitted to.
        rotorfit: Version that wrote it.
        uncertainty: The accuracy table; None where it was not asked for.
        prior: Coefficient, such as `x.input`, to what the card's prior did to it; None where no prior was used.
        physics: Axis name to physical quantities, as `physics.physics` gives them; for the reader of the file.
        conversion: Set where the model was converted to other limits than those of its flights.
        leave_one_out: Proof by leaving out each flight in turn, in the plain types of the file; None where it was not
            asked for. See `leave_one_out.LeaveOneOut`.
    """

    card: Card
    structure: str
    method: str
    axes: Mapping[str, Axis]
    covariance_names: tuple[str, ...]
    covariance: Array
    paper: tuple[float | None, ...]
    findings: tuple[Finding, ...]
    flights: tuple[Source, ...]
    rotorfit: str = __version__
    uncertainty: Uncertainty | None = None
    prior: Mapping[str, PriorUse] | None = None
    physics: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    conversion: Conversion | None = None
    leave_one_out: Mapping[str, Any] | None = None

    @property
    def gamma(self) -> tuple[float | None, ...]:
        """The paper's eight coefficients, g and b of x, y, z, yaw in turn; None where the data cannot tell."""
        return tuple(value for axis in AXES for value in (self.axes[axis].input, self.axes[axis].damping))


def with_findings(model: Model, findings: Sequence[Finding]) -> Model:
    """The model with these findings."""
    return replace(model, findings=tuple(findings))


def predictor_of(model: Model, axis: str) -> Predictor:
    """The predictor of an axis.

    Raises:
        ModelError: If the axis was not excited.
    """
    predictor = model.axes[axis].predictor
    if predictor is None:
        raise ModelError(
            f"the model has no numbers for {axis} ({model.axes[axis].status['input']}): fit a flight that moves it"
        )
    return predictor
