"""Model: coefficients with their uncertainty, disturbance levels, and provenance."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from rotorfit.core.display import (
    AXIS_COLOURS,
    FrameLibrary,
    IntervalMark,
    columns_of,
    counted,
    frame,
    html_table,
    interval,
    interval_panels,
    number,
    text_table,
)
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import AXES, Array
from rotorfit.version import __version__

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.axes import Axes

    from rotorfit.core.accuracy import PriorUse, Uncertainty
    from rotorfit.core.card import Card
    from rotorfit.core.finding import Finding
    from rotorfit.core.flight_data import Note
    from rotorfit.core.limits import Conversion

COEFFICIENTS = ("input", "damping", "delay")

STRUCTURE = "first_order_delay"
"""Name of the default law, `laws.FIRST_ORDER_DELAY`."""

FROZEN = "pose_frozen"
"""Status of what a frozen pose keeps from being known, and the finding about that coordinate of the pose."""

MEND = "the pose stood still under commands: first do what the finding pose_frozen says"
"""What to do about an axis that suffers from a frozen pose: more flights alone would not help."""

PLANNED = ", as `rotorfit plan` designs one"
"""Where to get the flight that a message asks for."""

Interval = tuple[float | None, float | None]

NORMAL = 1.959963984540054
"""Half width of a 95 % interval in standard errors: the 97.5 % point of the normal distribution."""


@dataclass(frozen=True)
class Combination:
    """A combination of coefficients that can be identifiable when its parts are not.

    Attributes:
        value: Estimate.
        ci95: 95 % interval for the vehicle; an open end is None.
        ci95_flight: 95 % interval for the flights of the fit alone; None where the two were not separated.
    """

    value: float
    ci95: Interval
    ci95_flight: Interval | None = None


@dataclass(frozen=True)
class Spread:
    """Variation of a coefficient or combination from flight to flight of one vehicle.

    Attributes:
        source: `flights` where several flights and the prior gave it; `prior` where there was one flight.
        sd: Standard deviation between flights: of the logarithm where `logarithmic`, else in the coefficient's unit.
        prior_sd: Scale of its prior, from recorded vehicles.
        flights_sd: Estimate from the flights alone, by restricted maximum likelihood; None for one flight.
        flights: Number of flights that gave it.
        p_value: Probability that flights without variation scatter at least as much; None for one flight.
        next_flight: 95 % interval for another flight, without its own noise; that of the vehicle is of its mean.
        logarithmic: Whether `sd` is that of the logarithm.
        each: Estimate from each flight of the fit alone and its standard error, on the same scale; None where the
            flight gives none. Empty for one flight.
    """

    source: str
    sd: float
    prior_sd: float
    flights_sd: float | None
    flights: int
    p_value: float | None
    next_flight: Interval
    logarithmic: bool
    each: tuple[tuple[float, float] | None, ...] = ()


@dataclass(frozen=True)
class Evidence:
    """A test of an axis that contradicts its numbers, and the consequence.

    Attributes:
        test: Short stable name: `follows_command`, `time`, `quarter`, `size`, `speed`, `method`, `bound`,
            `jerk`, `drag`, `slow`, `order`, `twice`.
        strength: The result of the test, one sentence.
        p_value: Probability of a result at least this extreme if the law is right.
        sd: Coefficient or combination to the standard deviation that the test adds, on the scale of its `Spread`.
        refutes: Whether no widening of the intervals can account for it.
    """

    test: str
    strength: str
    p_value: float
    sd: Mapping[str, float]
    refutes: bool = False


@dataclass(frozen=True)
class Predictor:
    """The likelihood's own estimate for an axis: what simulation and prediction use.

    Attributes:
        input: g [m/s^2 or rad/s^2 per unit of the command].
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
    """A structure that was tried for an axis, compared with its rival.

    Attributes:
        structure: Name.
        parameters: Number of parameters that it estimates for the axis.
        log_likelihood: Difference from the default structure.
        bic: Bayesian information criterion over `samples`, difference from the default structure.
        velocity: Held-out RMSE of 1 s velocity predictions [m/s or rad/s]; None where no prediction was possible.
        position: Held-out RMSE of the end points of 5 s predictions [m or rad]; None likewise.
        rival: The structure that it had to beat; empty for the first.
        velocity_change: Mean squared velocity error less the rival's, as a share of the rival's, and the standard error
            of that; None without a rival.
        position_change: The same for the squared end point errors.
        verdict: The conclusion, one sentence.
        chosen: Whether the model uses this structure.
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
class Weighed:
    """A law of the default family, with its weight given the data.

    Attributes:
        structure: Name.
        weight: Its posterior weight among the laws of the family, 0 to 1.
        log_likelihood: Difference from the first-order law with a delay.
        predictor: Its estimate.
        stderr: Name of each estimated parameter, coefficients first, then further parameters, to standard error.
        correlation: Correlation of those parameters, in that order.
    """

    structure: str
    weight: float
    log_likelihood: float
    predictor: Predictor
    stderr: Mapping[str, float]
    correlation: tuple[tuple[float, ...], ...]

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters named in `stderr`, in that order, shape (n, n)."""
        error = np.array(list(self.stderr.values()))
        return np.array(self.correlation) * np.outer(error, error)


@dataclass(frozen=True)
class Plain:
    """The first-order coefficients of an axis with another law, for comparison with the paper's eight.

    Attributes:
        input: g [m/s^2 or rad/s^2 per unit of the command].
        damping: b [1/s].
        delay: tau [s].
        stderr: Coefficient name to standard error.
        ci95: Coefficient name to 95 % interval.
        status: Coefficient name to status.
        law: The likelihood's own estimate with its covariance, whatever the statuses; None in old files.
    """

    input: float | None
    damping: float | None
    delay: float | None
    stderr: Mapping[str, float | None]
    ci95: Mapping[str, Interval]
    status: Mapping[str, str]
    law: Weighed | None = None


@dataclass(frozen=True)
class Mode:
    """An optimum of the likelihood that the search found.

    Attributes:
        delay: tau [s].
        damping: b [1/s].
        input: g [m/s^2 or rad/s^2 per unit of the command].
        log_likelihood: Difference from the best optimum.
        starts: Number of starting points that converged to it.
        prediction: RMSE of 1 s velocity predictions on the training flights [m/s or rad/s]; None where it was not
            needed.
        chosen: Whether the model uses this optimum.
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
    """Estimates for one axis of v' = input u(t - delay) - damping v + trim, or of its `structure`.

    Attributes:
        input: g, in m/s^2 (yaw: rad/s^2) per unit of the command; None where it is not identifiable.
        damping: b [1/s].
        delay: tau [s].
        stderr: Coefficient name to standard error.
        ci95: Coefficient name to 95 % interval for the vehicle; an open end is None.
        status: Coefficient name to `ok`, `not_excited`, `not_identifiable`, `refuted`, `diverged`, `too_short`,
            `pose_frozen` or `not_fitted`.
        trim: Constant acceleration in the heading frame, one per flight [m/s^2, yaw rad/s^2]; None where a flight was
            not used for this axis.
        noise: `wind_power`, `pose_variance`, `wind_damping`, `wind_overlap` and `trim_variance` of the disturbance;
            `velocity_variance` in addition to or instead of `pose_variance` where a velocity was measured.
        predictor: What simulation uses; None where the axis is not excited.
        combinations: `steady_gain` (g / b) and `total_lag` (delay, lag and 1 / b together) [s]; further ones for other
            structures; where the structure was chosen, `delay_plus_lag` [s] of `first_order_delay_lag`; for clocks
            with an unknown offset, `offset_plus_delay` [s] instead of `total_lag`.
        modes: Optima of the likelihood, the chosen one first.
        profile: Delays [s] and the profile log-likelihood at each, less its maximum.
        profile_fall: Fall of the profile at the ends of the delay's interval.
        structure: Name of its law.
        extra: Further parameters of that law, published like the coefficients; their standard errors, intervals and
            statuses stand beside those of the coefficients.
        plain: Coefficients of the first-order law with a delay, where this axis has another law.
        laws: The laws of the default family that the data do not rule out, the chosen one first; the intervals cover
            all of them. Empty where a structure was requested.
        lag_prior: Share of the information about the lag that comes from its prior, 0 to 1; None where no prior was
            used.
        candidates: Structures that were tried, where the structure was chosen.
        samples: Effective number of independent innovations used by the candidates' criterion; None likewise.
        ci95_flight: Coefficient name to 95 % interval for the flights of the fit alone: the uncertainty from noise and
            wind. Empty where the two were not separated, and `ci95` is both.
        spread: Coefficient or combination to its variation from flight to flight.
        evidence: Tests that contradict the numbers.
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
    laws: tuple[Weighed, ...] = ()
    lag_prior: float | None = None
    candidates: tuple[Candidate, ...] = ()
    samples: float | None = None
    ci95_flight: Mapping[str, Interval] = field(default_factory=dict)
    spread: Mapping[str, Spread] = field(default_factory=dict)
    evidence: tuple[Evidence, ...] = ()

    def __repr__(self) -> str:
        known = {"input": self.input, "damping": self.damping, "delay": self.delay, **self.extra}
        said = (
            f"{name} {self.status[name]}" if value is None else f"{name} {number(value)} ({interval(*self.ci95[name])})"
            for name, value in known.items()
        )
        return f"Axis({', '.join(said)})"


def weighed(
    structure: str,
    predictor: Predictor,
    names: Sequence[str],
    covariance: Array,
    weight: float = 1.0,
    log_likelihood: float = 0.0,
) -> Weighed:
    """A `Weighed` law from the covariance of its estimated parameters, shape (n, n), in the order of `names`."""
    error = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(error, error)
    return Weighed(
        structure,
        weight,
        log_likelihood,
        predictor,
        dict(zip(names, map(float, error), strict=True)),
        tuple(tuple(map(float, row)) for row in correlation),
    )


def unknown_axis(status: str) -> Axis:
    """An axis without any estimate; `status` says why."""
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
        path: Path of the log as given.
        sha256: Hex digest of the log.
        span: Start and end of the part used, within its common window [s].
        notes: Repairs.
        axes: The axes that it was used for.
        landmarks: Some of its poses, by which it is recognised in another file, see `flights.distinct`.
        pose_rate: Its fresh poses a second [Hz]; None in old files.
        commanded: Largest command of each of its axes, along the heading, in the unit of the card; empty in old files.
    """

    path: str
    sha256: str
    span: tuple[float, float]
    notes: tuple[Note, ...] = ()
    axes: tuple[str, ...] = ()
    landmarks: tuple[tuple[float, ...], ...] = ()
    pose_rate: float | None = None
    commanded: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Model:
    """A fitted model.

    Attributes:
        card: The card that was applied.
        structure: Name of the model structure; `mixed` where the axes have different ones.
        method: `ml`, `robust`, `paper`, `svf`, `weak`, `iv` or `oe`.
        axes: Axis name to its estimates, for all four axes.
        covariance_names: Row names of the covariance, such as `x.input`, over (input, damping, delay) of the excited
            axes.
        covariance: Shape (P, P).
        paper: gamma by the paper's method on the same data, shape (8,), None where it gives no number.
        findings: What the user should know.
        flights: The flights that it was fitted to.
        rotorfit: Version that wrote it.
        uncertainty: The accuracy table; None if it was not requested.
        prior: Coefficient, such as `x.input`, to the effect of the card's prior on it; None where no prior was used.
        conversion: Set where the model was converted to other limits than those of its flights.
        leave_one_out: Cross-validation that leaves out each flight in turn, in the plain types of the file; None if it
            was not requested. See `leave_one_out.LeaveOneOut`.
        paper_noise: Axis name to the disturbance levels at the paper's coefficients, for the filter from which the
            paper's predictions start. Empty for files of versions that did not write them.
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
    conversion: Conversion | None = None
    leave_one_out: Mapping[str, Any] | None = None
    paper_noise: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return text_table(self._title(), self._HEADS, self._texts())

    def _repr_html_(self) -> str:
        return html_table(self._title(), self._HEADS, self._texts(), self.findings)

    @overload
    def to_frame(self, library: Literal["polars"] = "polars") -> pl.DataFrame: ...
    @overload
    def to_frame(self, library: Literal["pandas"]) -> Any: ...
    def to_frame(self, library: FrameLibrary = "polars") -> Any:
        """The coefficients as a data frame, one row each.

        Args:
            library: `polars`, or `pandas`, which must be installed.

        Returns:
            A `DataFrame` with the columns `axis`, `coefficient`, `estimate`, `stderr`, `low` and `high` of the 95 %
            interval, `status`, `structure`; null where not identifiable, and for open ends.

        Raises:
            ModuleNotFoundError: pandas is requested but not installed.
        """
        heads = ("axis", "coefficient", "estimate", "stderr", "low", "high", "status", "structure")
        return frame(columns_of(heads, self._rows()), library)

    def plot(self) -> tuple[Axes, ...]:
        """Draws the coefficients with their 95 % intervals, open ends as arrows, beside those of the paper's method.

        Returns:
            Three matplotlib axes: input, damping and delay.
        """
        paper = dict(zip(((axis, name) for axis in AXES for name in COEFFICIENTS[:2]), self.paper, strict=True))
        known: dict[str, list[IntervalMark]] = {name: [] for name in COEFFICIENTS}
        for axis, name, value, _, low, high, *_ in self._rows():
            if name in known and value is not None:
                known[name].append(IntervalMark(axis, value, low, high, AXIS_COLOURS[axis], paper.get((axis, name))))
        titles = ("input [m/s², yaw rad/s²]", "damping [1/s]", "delay [s]")
        return interval_panels(list(zip(titles, known.values(), strict=True)), "the paper's method")

    _HEADS = ("axis", "coefficient", "estimate", "95 % interval", "status")

    def _title(self) -> str:
        made = f"{counted(len(self.flights), 'flight')}, {counted(len(self.findings), 'finding')}"
        return f"Model of {self.card.name!r}: method {self.method}, structure {self.structure}, {made}"

    def _rows(self) -> list[tuple[Any, ...]]:
        return [
            (name, each, value, axis.stderr[each], *axis.ci95[each], axis.status[each], axis.structure)
            for name, axis in self.axes.items()
            for each, value in {**{one: getattr(axis, one) for one in COEFFICIENTS}, **axis.extra}.items()
        ]

    def _texts(self) -> list[tuple[str, ...]]:
        return [
            (axis, name, number(value), interval(low, high), status)
            for axis, name, value, _, low, high, status, _ in self._rows()
        ]

    @property
    def gamma(self) -> tuple[float | None, ...]:
        """The paper's eight coefficients, g and b of x, y, z, yaw in turn; None where the data cannot tell."""
        return tuple(value for axis in AXES for value in (self.axes[axis].input, self.axes[axis].damping))


def with_findings(model: Model, findings: Sequence[Finding]) -> Model:
    """A copy of the model with these findings."""
    return replace(model, findings=tuple(findings))


def predictor_of(model: Model, axis: str) -> Predictor:
    """The predictor of an axis.

    Raises:
        ModelError: The axis was not excited.
    """
    predictor = model.axes[axis].predictor
    if predictor is None:
        raise ModelError(f"the model has no numbers for {axis} {unknown_why(model, axis)}")
    return predictor


def first_order_beside(axis: Axis) -> Predictor | None:
    """The first-order law with a delay that is stored beside another law of an axis."""
    return axis.plain.law.predictor if axis.plain and axis.plain.law else None


def unknown_why(model: Model, axis: str) -> str:
    """Status of an axis without numbers, in brackets, and what to do."""
    status = model.axes[axis].status["input"]
    if status == "refuted":
        return "(refuted): the flights deny the law that was asked for; fit without --structure"
    if status == "not_identifiable" and first_order_beside(model.axes[axis]):
        return "(not_identifiable): the law that was asked for does not tell its input; fit without --structure"
    return f"({status}): {MEND if status == FROZEN else f'fit a flight that moves it{PLANNED}'}"


def laws_of_vehicle(model: Model, axis: str) -> tuple[Weighed, ...]:
    """The laws that an axis may have, its own first, with the uncertainty of the vehicle.

    The covariance of the model is that of its own law. The others are widened as much, parameter by parameter.

    Raises:
        ModelError: The axis was not excited.
    """
    known, point = model.axes[axis], predictor_of(model, axis)
    names = [name.partition(".")[2] for name in model.covariance_names if name.startswith(f"{axis}.")]
    at = [model.covariance_names.index(f"{axis}.{name}") for name in names]
    chosen = weighed(known.structure, point, names, model.covariance[np.ix_(at, at)])
    if len(known.laws) < 2:
        return (chosen,)
    own = known.laws[0]
    wider = {name: chosen.stderr[name] / own.stderr[name] for name in names if name in own.stderr}
    most = max(wider.values(), default=1.0)
    others = [
        replace(law, stderr={name: error * wider.get(name, most) for name, error in law.stderr.items()})
        for law in known.laws[1:]
    ]
    return (replace(chosen, weight=own.weight), *others)


def first_order(model: Model, axis: str) -> Weighed:
    """An axis as a first-order law with a delay: its own law, or the one stored beside another law.

    Raises:
        ModelError: The axis was not excited.
    """
    point, plain = predictor_of(model, axis), model.axes[axis].plain
    if plain is not None and plain.law is not None:
        return plain.law
    if plain is not None and plain.input is not None and plain.damping is not None:
        beside = Predictor(plain.input, plain.damping, point.delay if plain.delay is None else plain.delay)
        errors = {name: error for name, error in plain.stderr.items() if error is not None}
        return weighed(STRUCTURE, beside, list(errors), np.diag(np.square(list(errors.values()))))
    names = [name for name in COEFFICIENTS if f"{axis}.{name}" in model.covariance_names]
    at = [model.covariance_names.index(f"{axis}.{name}") for name in names]
    return weighed(STRUCTURE, replace(point, extra={}), names, model.covariance[np.ix_(at, at)])


def pose_rates(model: Model, axes: Collection[str]) -> tuple[float, ...]:
    """Fresh poses a second [Hz] of the flights that the axes were fitted to, in ascending order.

    Empty where none of the axes has a position in them, and for files of versions that did not write it.
    """
    seen = {axis for axis in axes if not by_velocity_alone(model, axis)}
    return tuple(sorted(flight.pose_rate for flight in model.flights if flight.pose_rate and seen & {*flight.axes}))


def by_velocity_alone(model: Model, axis: str) -> bool:
    """Whether an axis was fitted to velocities, without positions."""
    noise = model.axes[axis].noise
    return "velocity_variance" in noise and "pose_variance" not in noise
