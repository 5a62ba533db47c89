"""Results: Fit with the paper's regression, Validation with scores, paired tests and residual tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from rotorfit.core.display import (
    PREDICTOR_LOOKS,
    FrameLibrary,
    Line,
    Panel,
    columns_of,
    counted,
    frame,
    html_table,
    line_panels,
    number,
    short_repr,
    text_table,
)
from rotorfit.core.errors import FlightError
from rotorfit.core.frames import AXES, Array

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.axes import Axes

    from rotorfit.core.error_bands import Scores
    from rotorfit.core.finding import Finding
    from rotorfit.core.flight_data import Flight
    from rotorfit.core.frequency_response import ResponseComparison
    from rotorfit.core.model import Model
    from rotorfit.core.residuals import ResidualTests

KEPT_HEADING = np.radians(10.0)
"""Range of the heading [rad] over which it hardly matters whether a prediction is told it or predicts it."""

PaperStatus = Literal["ok", "not_excited", "not_identifiable", "too_short"]


@dataclass(frozen=True)
class Motion:
    """Input of the regression from one flight: the N pose stamps at which the command is known and a whole window fits.

    Attributes:
        time: Stamps, shape (N,) [s].
        yaw: Heading, shape (N,) [rad].
        command: Command held at the stamp, x, y, z, yaw, in the heading frame, shape (N, 4).
        velocity: x, y, z, yaw, in the HEADING frame, shape (N, 4) [m/s, rad/s].
        acceleration: x, y, z, yaw, in the WORLD frame, shape (N, 4) [m/s^2, rad/s^2].
    """

    time: Array
    yaw: Array
    command: Array
    velocity: Array
    acceleration: Array

    __repr__ = short_repr


@dataclass(frozen=True)
class PaperFit:
    """Result of the paper's regression. Length 8 is gamma_1 .. gamma_8: input and damping of x, y, z, yaw.

    Attributes:
        gamma: Shape (8,); NaN for an axis without numbers.
        stderr: Shape (8,), from `covariance`.
        covariance: Shape (8, 8), robust to autocorrelated residuals (Newey and West), NaN as in `gamma`.
        covariance_ols: Shape (8, 8), the textbook sigma^2 (X^T X)^-1; far too small here, kept for comparison.
        status: Requested axis to its status.
        reason: Axis whose status is not `ok` to the reason, one sentence.
        r_squared: Axis to the explained share of the variance of its acceleration, x and y in the heading frame.
        condition: Axis to the condition number of its equation, columns scaled to unit length.
        lag: Axis to the lag up to which autocorrelation of the residuals enters `covariance` [s].
        rows: Axis to the number of pose stamps used.
        half_width: Half the width of the window [s].
        degree: Degree of the polynomial.
        motions: Measured accelerations, one element per flight, in the order of the flights.
        modelled: Accelerations by eq. (6) at the same stamps, WORLD frame, shape (N, 4) per flight. Together with
            `motions` they are the paper's Figure 4; see `modelled_acceleration` for axes without numbers.
    """

    gamma: Array
    stderr: Array
    covariance: Array
    covariance_ols: Array
    status: Mapping[str, PaperStatus]
    reason: Mapping[str, str]
    r_squared: Mapping[str, float]
    condition: Mapping[str, float]
    lag: Mapping[str, float]
    rows: Mapping[str, int]
    half_width: float
    degree: int
    motions: tuple[Motion, ...]
    modelled: tuple[Array, ...]

    __repr__ = short_repr


HORIZONS = (0.5, 1.0, 2.0, 5.0)
"""Default horizons of the scores [s]."""

CURVE = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)
"""Horizons of the report's curves [s]."""


@dataclass(frozen=True)
class Horizon:
    """Errors at one horizon.

    Attributes:
        velocity_rmse: Over all steps up to the horizon [m/s or rad/s]; None for fewer than five predictions.
        position_rmse: At the end point, against the measured pose [m or rad]; None likewise, and where only the
            velocity is measured.
        n: Number of predictions.
    """

    velocity_rmse: float | None
    position_rmse: float | None
    n: int


@dataclass(frozen=True)
class AxisScore:
    """Errors of one axis of one flight.

    Attributes:
        horizons: Horizon [s] as `%g` to errors.
        fit_percent: 100 (1 - ||v - v^|| / ||v - mean v||) of the 1 s velocity predictions.
    """

    horizons: Mapping[str, Horizon]
    fit_percent: float | None


@dataclass(frozen=True)
class StartErrors:
    """Squared errors for each start, over all segments of a flight, for the paired tests; S starts.

    The scores follow from their sums: velocity RMSE = sqrt(velocity.sum() / steps.sum()), position RMSE =
    sqrt(mean position).

    Attributes:
        start: Start times, shape (S,) [s].
        velocity: Squared velocity errors summed over the steps up to the horizon, shape (S, 4) [m^2/s^2 or rad^2/s^2].
        steps: Number of those steps, shape (S, 4).
        position: Squared errors of the end point, shape (S, 4) [m^2 or rad^2].
    """

    start: Array
    velocity: Array
    steps: Array
    position: Array

    __repr__ = short_repr


def student_quantile(freedom: float) -> float:
    """97.5 % point of Student's t distribution."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975))


@dataclass(frozen=True)
class Outlier:
    """A pose that was excluded as an outlier.

    Attributes:
        time: Stamp of the pose [s].
        axis: Axis of the largest deviation in standard deviations.
        size: Distance from the filter's prediction [m or rad].
    """

    time: float
    axis: str
    size: float


Outliers = tuple[tuple[Outlier, ...], ...]
"""Outliers of each flight."""

BRAKING_LEVEL = 1e-4
"""p-value below which braking is a finding."""

LEAST_BRAKING = 0.3
"""Least further damping that is reported, as a share of the law's own damping (at least 1 [1/s])."""


@dataclass(frozen=True)
class Braking:
    """Test of one axis for further damping while its command is zero.

    Attributes:
        further: Damping in addition to the law's own while the command is zero, from one linearised step [1/s].
        error: Its standard error [1/s].
        probability: p-value of no further damping.
        share: Share of the flights during which the command is zero.
        damping: Damping of the law [1/s].
        late: Delay of the law and twice its lag [s], as `commanded_parts` takes it.
    """

    further: float
    error: float
    probability: float
    share: float
    damping: float
    late: float

    @property
    def acts(self) -> bool:
        """Whether the further damping is significant and large compared with the law's."""
        return self.probability < BRAKING_LEVEL and self.further > LEAST_BRAKING * max(self.damping, 1.0)


@dataclass(frozen=True)
class Fit:
    """A model and the flights that it was fitted to.

    Attributes:
        model: Coefficients, intervals, statuses.
        flights: In the order of `model.flights`.
        paper: The paper's regression on the same flights.
        estimates: Axis name to the maximum of its likelihood, an `Estimate` of the estimation; empty for other methods.
        remarks: Axis name to remarks of a rung on its numbers: why there is none, which instrument.
        outliers: Poses of each flight that the robust method excluded.
        braking: Axis that obeys another law while its command is zero, to the test that shows it and the duration of
            the parts that it was fitted to [s].
    """

    model: Model
    flights: tuple[Flight, ...]
    paper: PaperFit
    estimates: Mapping[str, Any] = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)
    outliers: Outliers = ()
    braking: Mapping[str, tuple[Braking, float]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Fit to {', '.join(repr(flight.path) for flight in self.flights)}\n{self.model!r}"

    def _repr_html_(self) -> str:
        return self.model._repr_html_()


Verdict = Literal["better", "worse", "no_difference_shown", "too_short"]

Quantity = Literal["velocity", "position"]


@dataclass(frozen=True)
class Difference:
    """Errors of a first predictor less those of a second on the same starts.

    Attributes:
        n: Number of pairs of predictions.
        rmse: Difference of the RMSE [m/s, m; rad/s, rad]: negative where the first is better.
        rmse_stderr: Its standard error, by the delta method; None if there are too few pairs.
        freedom: Degrees of freedom of `rmse_stderr`; None likewise.
        p: Two-sided p-value, by Student's t; None likewise.
        mse: Difference of the mean squared errors, in the same units squared.
        mse_stderr: Its standard error; None likewise.
        verdict: On the first: `better`, `worse`, `no_difference_shown` at 95 %, or `too_short` for a standard error.
    """

    n: int
    rmse: float
    rmse_stderr: float | None
    freedom: float | None
    p: float | None
    mse: float
    mse_stderr: float | None
    verdict: Verdict

    @property
    def rmse_ci95(self) -> tuple[float, float] | None:
        """95 % interval of the difference of the RMSE, by Student's t: it contains 0 where no difference is shown."""
        if self.rmse_stderr is None or self.freedom is None:
            return None
        half = student_quantile(self.freedom) * self.rmse_stderr
        return self.rmse - half, self.rmse + half


@dataclass(frozen=True)
class Paired:
    """Paired test of one axis and quantity at one horizon.

    Attributes:
        flights: One per flight; None where one of the two predicts nothing, or fewer than five starts are common.
        pooled: All flights that count, weighted by their number of predictions; None where none counts.
        agreement: p-value that the difference is the same on all flights that count and are long enough for this test;
            None for fewer than two.
        left_out: Number of flights that count, but are too short for a standard error beside others that are not: they
            are not in `pooled`.
        pooled_flights: Places of the flights in `pooled`.
    """

    flights: tuple[Difference | None, ...]
    pooled: Difference | None
    agreement: float | None
    left_out: int = 0
    pooled_flights: tuple[int, ...] = ()


@dataclass(frozen=True)
class PairedTest:
    """Paired test of two predictors on the same flights.

    Attributes:
        first: Name of the predictor that is judged.
        second: Name of the predictor that it is compared with.
        axes: Axis name to horizon [s] as `%g` to `velocity` and `position`.
    """

    first: str
    second: str
    axes: Mapping[str, Mapping[str, Mapping[Quantity, Paired]]]


@dataclass(frozen=True)
class FlightScores:
    """Prediction errors on one flight.

    Attributes:
        path: Path of its log.
        span: Start and end of the part used, within its common window [s].
        axes: Axis name to errors; for an axis without a model every number is None.
        heading: `predicted` by the model's own yaw, or `measured` where it has none.
        fitted: Whether the model was fitted to part of this stretch: then the scores prove nothing.
        moved: The axes that the flight excites itself, rather than merely holding while another axis moves them.
        turned: Range of the heading within the segments of the flight [rad].
        held: The axes that it commands, but only holds while another flight moves them: they are not pooled.
    """

    path: str
    span: tuple[float, float]
    axes: Mapping[str, AxisScore]
    heading: str
    fitted: bool = False
    moved: tuple[str, ...] = ()
    turned: float = 0.0
    held: tuple[str, ...] = ()

    def unlike(self, other: FlightScores) -> tuple[str, ...]:
        """Axes whose errors cannot be compared with another predictor's on the same flight.

        They are x and y of a flight that turns, where only one of the two takes its heading as recorded.
        """
        turns = max(self.turned, other.turned) > KEPT_HEADING
        return ("x", "y") if turns and self.heading != other.heading else ()


def named_apart(flights: Sequence[FlightScores], folders: bool = True) -> list[str]:
    """Paths of flights, or names of their files; with the stretch where several are of one log."""
    paths = [flight.path for flight in flights]
    return [
        (path if folders else Path(path).name)
        + (f", {flight.span[0]:.1f} to {flight.span[1]:.1f} s" if paths.count(path) > 1 else "")
        for path, flight in zip(paths, flights, strict=True)
    ]


def pool_lines(flights: Sequence[FlightScores], tests: Sequence[PairedTest]) -> list[str]:
    """What pooled figures leave out as merely held, and the flights behind them where not all are over the same."""
    names = named_apart(flights, folders=False)
    lines = [
        f"not pooled: {', '.join(flight.held)} of {name}, merely held: commands below a fifth of another flight's, "
        "which by themselves do not plainly explain its motion"
        for flight, name in zip(flights, names, strict=True)
        if flight.held
    ]
    for (axes, places), pairs in _pools_apart(tests).items():
        told = ", ".join(names[place] for place in places)
        lines.append(
            f"not all are pooled over the same flights: {', '.join(axes)} of {', '.join(pairs)} over "
            f"{counted(len(places), 'flight')}, {told}"
        )
    return lines


def _pools_apart(tests: Sequence[PairedTest]) -> dict[tuple[tuple[str, ...], tuple[int, ...]], list[str]]:
    """Axes and places of flights to the tests pooled over these, for the axes of which tests are pooled over others."""
    behind: dict[tuple[str, tuple[int, ...]], list[str]] = {}
    for axis in AXES:
        first = [(test, next(iter(test.axes[axis].values()), {}).get("velocity")) for test in tests]
        pooled = [(f"{test.first} vs {test.second}", one.pooled_flights) for test, one in first if one and one.pooled]
        for test_and_places in pooled if len({places for _, places in pooled}) > 1 else ():
            behind.setdefault(test_and_places, []).append(axis)
    out: dict[tuple[tuple[str, ...], tuple[int, ...]], list[str]] = {}
    for (pair, places), axes in behind.items():
        out.setdefault((tuple(axes), places), []).append(pair)
    return out


SCORE_COLUMNS = (
    "flight", "fitted", "axis", "moved", "predictor", "horizon", "velocity_rmse", "position_rmse", "n", "fit_percent",
)  # fmt: skip
"""Columns of the rows of a validation."""


@dataclass(frozen=True)
class LeftOut:
    """One coefficient across the fits that each leave out one flight.

    Attributes:
        axis: `x`, `y`, `z` or `yaw`.
        name: `input`, `damping`, `delay`, `steady_gain` or `total_lag`.
        values: The predictor's value for each left-out flight; None where that flight does not move the axis, or the
            others do not identify it.
        low: The smallest.
        high: The largest.
        jackknife_stderr: Jackknife standard error of the fit to all flights; None unless every flight that moves the
            axis can be left out.
    """

    axis: str
    name: str
    values: tuple[float | None, ...]
    low: float
    high: float
    jackknife_stderr: float | None


@dataclass(frozen=True)
class Validation:
    """Prediction errors of a model and of the naive baselines on the same flights.

    Attributes:
        flights: Scores of the model, one element per flight.
        baselines: `hold` (the world velocity at the start is kept), `paper` (the paper's coefficients of the model's
            training flights, without delay, with their own filter, trim and initial state) and `coast` (the same
            coefficients from the state of the model's filter, without trim and disturbance), each one element per
            flight.
        errors: `model`, `hold`, `paper` and `coast` to the errors behind the scores, start by start: one mapping per
            flight, from the horizon; NaN for an axis without a model.
        paired: The model against each baseline.
        residuals: One mapping per flight, from the axes that it commands and the model knows to the innovation tests.
        findings: Errors of the flights, and findings from the tests of the innovations and of the frequency responses.
        responses: One mapping per flight, from the same axes to their frequency responses compared with the model's.
        bands: One mapping per flight, from the axes that the model knows and the horizons to the coverage of the error
            bands that the predictor stated.
    """

    flights: tuple[FlightScores, ...]
    baselines: Mapping[str, tuple[FlightScores, ...]]
    errors: Mapping[str, tuple[Mapping[str, StartErrors], ...]] = field(default_factory=dict)
    paired: tuple[PairedTest, ...] = ()
    residuals: tuple[Mapping[str, ResidualTests], ...] = ()
    findings: tuple[Finding, ...] = ()
    responses: tuple[Mapping[str, ResponseComparison], ...] = ()
    bands: tuple[Scores, ...] = ()

    @property
    def spent(self) -> tuple[str, ...]:
        """The axes that only flights move to which the model was fitted, at least in part: they prove nothing."""
        moved = {fitted: {a for f in self.flights if f.fitted == fitted for a in f.moved} for fitted in (True, False)}
        return tuple(axis for axis in AXES if axis in moved[True] - moved[False])

    @property
    def misread(self) -> tuple[Finding, ...]:
        """Errors in the data of the flights, or in how the card reads them: the scores do not judge the model."""
        return tuple(finding for finding in self.findings if finding.severity == "error")

    @property
    def before_scores(self) -> tuple[Finding, ...]:
        """What must be read before the scores: they may not be the model's."""
        converted = [finding for finding in self.findings if finding.code == "converted"]
        return (*self.misread, *converted)

    def __repr__(self) -> str:
        return text_table(*self._table())

    def _repr_html_(self) -> str:
        return html_table(*self._table(), self.findings)

    @overload
    def to_frame(self, library: Literal["polars"] = "polars") -> pl.DataFrame: ...
    @overload
    def to_frame(self, library: Literal["pandas"]) -> Any: ...
    def to_frame(self, library: FrameLibrary = "polars") -> Any:
        """The prediction errors as a data frame, one row for each flight, axis, predictor and horizon.

        Args:
            library: `polars`, or `pandas`, which must be installed.

        Returns:
            A `DataFrame` with the columns `flight`, `fitted` (the model was fitted to part of it), `axis`, `moved` (the
            flight excites the axis), `predictor` (`model`, `hold`, `paper`, `coast`), `horizon` [s], `velocity_rmse`
            [m/s or rad/s], `position_rmse` [m or rad], `n` and `fit_percent`; null where there is no number.

        Raises:
            ModuleNotFoundError: pandas is requested but not installed.
        """
        return frame(columns_of(SCORE_COLUMNS, self.rows()), library)

    def rows(self) -> list[tuple[Any, ...]]:
        """The rows of `to_frame`, with the columns `SCORE_COLUMNS`."""
        everyone = {"model": self.flights, **self.baselines}
        scores = [
            ((flight.path, flight.fitted, axis, axis in flight.moved, predictor), score)
            for predictor, flights in everyone.items()
            for flight in flights
            for axis, score in flight.axes.items()
        ]
        return [
            (*whose, float(horizon), one.velocity_rmse, one.position_rmse, one.n, score.fit_percent)
            for whose, score in scores
            for horizon, one in score.horizons.items()
        ]

    def plot(self) -> tuple[Axes, ...]:
        """Draws the prediction errors over the horizon, one line for each flight that moves the axis.

        Returns:
            The matplotlib axes: velocity errors of each axis, then position errors.

        Raises:
            FlightError: No flight moves an axis.
        """
        axes = [axis for axis in AXES if any(axis in flight.moved for flight in self.flights)]
        labels = {
            f"{what}_rmse": {axis: f"{what} error [{'rad' if axis == 'yaw' else 'm'}{per}]" for axis in axes}
            for what, per in (("velocity", "/s"), ("position", ""))
        }
        panels = [
            Panel(axis, "horizon [s]", label, self._lines(axis, error), y_log=True)
            for error, of_axis in labels.items()
            for axis, label in of_axis.items()
        ]
        if not panels:
            raise FlightError("nothing to draw: no flight of the validation moves an axis")
        return line_panels(panels, len(axes), (2.7, 2.2))

    def _lines(self, axis: str, error: str) -> list[Line]:
        """Lines of one panel, one for each predictor and flight."""
        lines = []
        for predictor, flights in {"model": self.flights, **self.baselines}.items():
            for horizons in (flight.axes[axis].horizons for flight in flights if axis in flight.moved):
                errors = np.array([getattr(each, error) for each in horizons.values()], float)
                lines.append(Line(predictor, np.array(list(horizons), float), errors, PREDICTOR_LOOKS[predictor]))
        return lines

    def _table(self) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
        """Title, heads and rows: velocity errors of the moved axes at the horizon nearest to 1 s."""
        horizons = {horizon for flight in self.flights for score in flight.axes.values() for horizon in score.horizons}
        if not horizons:
            return "Validation on no flight", (), []
        shown = min(horizons, key=lambda horizon: abs(float(horizon) - 1.0))
        everyone = {"model": self.flights, **self.baselines}
        rows = []
        for place, flight in enumerate(self.flights):
            for axis in flight.moved:
                scores = [each[place].axes[axis].horizons[shown] for each in everyone.values()]
                rows.append((flight.path, axis, *(number(score.velocity_rmse) for score in scores)))
        what = f"error of the velocity up to {shown} s ahead [m/s, yaw rad/s]"
        title = f"Validation on {counted(len(self.flights), 'flight')}: {what}"
        return title, ("flight", "axis", *everyone), rows
