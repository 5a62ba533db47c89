"""Model + other flights -> Validation: prediction errors beside naive baselines, and tests of the residuals."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, Literal

import numpy as np

from rotorfit.assessment.frequency.comparison import findings_of_responses, response_mapping, response_test
from rotorfit.assessment.frequency.loop import findings_of_loops
from rotorfit.assessment.innovations import residual_tests_of_flight, unclocked, was_fitted
from rotorfit.assessment.mismatch import findings_of_mismatch
from rotorfit.assessment.paired import paired_scores
from rotorfit.assessment.whiteness import findings_of_residuals
from rotorfit.core import parallel
from rotorfit.core.error_bands import BandScore
from rotorfit.core.errors import FlightError
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import FIRST_ORDER_DELAY, LEVELS_OF, structure_named
from rotorfit.core.limits import disagreement, limit_text, meaning_of
from rotorfit.core.model import Model, Predictor
from rotorfit.core.progress import Progress
from rotorfit.core.results import HORIZONS, AxisScore, FlightScores, Horizon, StartErrors, Validation
from rotorfit.dynamics.error_bands import Stated, band_scores, stated
from rotorfit.dynamics.other_limits import flown_card
from rotorfit.dynamics.protocol import (
    AxisDynamics,
    Errors,
    free_run_prediction,
    hold_velocity,
    joined,
    judged,
    predictions,
    scores_of,
)
from rotorfit.estimation.excitation import without_idle_axes
from rotorfit.estimation.likelihood.blocks import HELD_HEADING
from rotorfit.flights.distinct import check_distinct, check_flights

BASELINES = ("hold", "paper", "coast")
"""See `Validation`. Either of the last two can be the better use of the paper's coefficients."""


def dynamics_from_model(model: Model, flight: Flight | None = None) -> dict[str, AxisDynamics]:
    """Dynamics that predictions need, for the axes of a model; axes with noise but no predictor are only tracked.

    Args:
        model: The model.
        flight: The flight to predict; None for one with a position of every axis.

    Raises:
        FlightError: An axis has a position where the model knows only the noise of a velocity, or the other way round.
    """
    out, alone = {}, flight.velocity_only if flight else ()
    for name, axis in model.axes.items():
        if not axis.noise or (name == "yaw" and axis.predictor is None):
            continue
        point = axis.predictor
        levels = LEVELS_OF["velocity" if name in alone else "position"]
        if not set(levels) <= set(axis.noise):
            here, there = ("velocity", "position") if name in alone else ("position", "velocity")
            raise FlightError(
                f"{flight.path if flight else 'the flight'}: {name} is measured by its {here}, and the model knows the "
                f"noise of its {there} only: use the card that it was fitted with, or fit again"
            )
        out[name] = AxisDynamics(
            input=point.input if point else 0.0,
            damping=point.damping if point else 1.0,
            delay=point.delay if point else 0.0,
            levels=tuple(axis.noise[level] for level in levels),  # type: ignore[arg-type]
            trim_variance=axis.noise["trim_variance"],
            structure=structure_named(axis.structure) if point else FIRST_ORDER_DELAY,
            extra=point.extra if point else {},
        )
    return out


def validate(
    model: Model, flights: Sequence[Flight], horizons: Sequence[float] = HORIZONS, progress: Progress | None = None
) -> Validation:
    """Scores a model on flights by the one prediction protocol.

    Args:
        model: The model.
        flights: Flights to which it was not fitted, for a validation; others for comparison.
        horizons: Prediction horizons [s].
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        TypeError: `flights` holds something else than flights.
        FlightError: No flight is given, one is given twice, a horizon is not positive, or as for `dynamics_from_model`.
    """
    check_flights(flights)
    return validate_chosen(model, without_idle_axes(flights), horizons, progress)


def check_validation(model: Model, flights: Sequence[Flight], horizons: Sequence[float]) -> None:
    """Refuses what `validate` refuses, with the same errors, and calls no kernel: nothing is compiled for an error."""
    check_flights(flights)
    if not flights:
        raise FlightError("no flight to validate on: give at least one log")
    if not horizons or min(horizons) <= 0:
        raise FlightError(f"horizons must be positive seconds, not {', '.join(f'{h:g}' for h in horizons)}")
    check_distinct(flights)
    for flight in flights:
        dynamics_from_model(model, flight)


def validate_chosen(
    model: Model,
    flights: Sequence[Flight],
    horizons: Sequence[float] = HORIZONS,
    progress: Progress | None = None,
    assumed: bool = False,
) -> Validation:
    """As `validate`, on flights without the axes that they only hold, see `without_idle_axes`.

    Args:
        model: As for `validate`.
        flights: As for `validate`.
        horizons: As for `validate`.
        progress: As for `validate`.
        assumed: Whether flights that were read with the model's card had no other: nobody says that it is theirs.
    """
    check_validation(model, flights, horizons)
    scores: dict[str, list[FlightScores]] = {name: [] for name in ("model", *BASELINES)}
    errors: dict[str, list[Mapping[str, StartErrors]]] = {name: [] for name in scores}
    tests, bands = [], []
    for number, flight in enumerate(flights):

        def report(share: float, number: int = number, path: str = flight.path) -> None:
            if progress:
                progress((number + share) / len(flights), path)

        scored, held = _score_flight(model, flight, horizons, report)
        for name, (score, by_horizon) in scored.items():
            scores[name].append(score)
            errors[name].append(by_horizon)
        bands.append({axis: held[axis] for axis in AXES if model.axes[axis].predictor})
        tests.append(residual_tests_of_flight(model, flight))
    responses = response_test(model, flights)
    misread = [tuple(findings_of_mismatch(model, flight)) for flight in flights]
    touched = [_touched(each) for each in misread]  # of these axes a flight says nothing about the model
    found = [
        finding
        for flight, axes, wrong in zip(flights, tests, touched, strict=True)
        for axis, each in axes.items()
        if not wrong & {axis, None}
        for finding in findings_of_residuals(axis, each, flight.path)
    ]
    found += findings_of_responses(
        [
            {axis: each for axis, each in axes.items() if not wrong & {axis, None}}
            for axes, wrong in zip(responses, touched, strict=True)
        ]
    )
    found += [_delay_not_tested(flight) for flight in flights if unclocked(model, flight)]
    known = [axis for axis in AXES if model.axes[axis].predictor]
    found += _of_conversion(model, flights, assumed)
    found += alone_in_the_plane(known, flights)
    found += findings_of_loops(flights, known, max(horizons))
    found = [*(one for each in misread for one in each), *sorted(found, key=lambda finding: finding.severity == "info")]
    own = scores["model"], errors["model"]
    return Validation(
        flights=tuple(scores["model"]),
        baselines={name: tuple(scores[name]) for name in BASELINES},
        errors={name: tuple(each) for name, each in errors.items()},
        paired=tuple(paired_scores(("model", name), own, (scores[name], errors[name])) for name in BASELINES),
        residuals=tuple(tests),
        findings=tuple(found),
        responses=responses,
        bands=tuple(bands),
    )


def _of_conversion(model: Model, flights: Sequence[Flight], assumed: bool) -> Iterator[Finding]:
    """A finding for each axis whose commands a converted model takes for fractions of its new limit, unconfirmed."""
    same = model.card.raw
    read = [one for one in flights if (assumed and one.card.raw == same) or disagreement(one.card, model.card)]
    for axis, factor in model.conversion.factor.items() if model.conversion and read else ():
        limit = meaning_of(model.card, axis).limit
        if factor == 1 or limit is None or model.axes[axis].predictor is None:
            continue
        now, before = (limit_text(limit, card.limits[limit]) for card in (model.card, flown_card(model)))
        names = [flight.path for flight in read if axis in flight.moved and was_fitted(model, flight)]
        yield Finding(
            "converted",
            "warning",
            f"the model was converted: the commands of {axis} are read as given under a {limit.replace('_', ' ')} "
            f"limit of {now}, not of {before} as in the flights that it was fitted to"
            + f", such as {', '.join(dict.fromkeys(names))}"
            * bool(names),
            f"of flights under the former limit, scores, verdicts and residual tests of {axis} are wrong",
            "score the model on flights under its new limits, with --card and a card that states them; or score it as "
            "it was before the conversion",
            axis,
        )


def alone_in_the_plane(known: Sequence[str], flights: Sequence[Flight]) -> Iterator[Finding]:
    """A finding on x or y where the heading turns while the other one, which the model does not know, is commanded.

    Args:
        known: The axes that have numbers.
        flights: The flights on which they are predicted.
    """
    for axis, other in (("x", "y"), ("y", "x")):
        turned = max((_turn(flight) for flight in flights if {axis, other} <= set(flight.moved)), default=0.0)
        if axis in known and other not in known and turned > 2 * HELD_HEADING:
            yield Finding(
                "other_axis_unknown",
                "warning",
                f"{axis} is predicted without {other}, of which the model has no numbers, while the heading turns by "
                f"up to {np.degrees(turned):.0f} degrees",
                f"what the commands of {other} do counts as an error of {axis}: scores, verdicts and residual tests of "
                f"{axis} are not those of its coefficients",
                f"fit {other} as well, or validate {axis} on flights that keep their heading",
                axis,
            )


def _turn(flight: Flight) -> float:
    """Range of the heading within the segments of a flight [rad]."""
    inside = np.zeros(flight.yaw.size, bool)
    for part in flight.segments:
        inside |= (flight.pose_time >= part.start) & (flight.pose_time <= part.end)
    return float(np.ptp(flight.yaw[inside])) if inside.any() else 0.0


def _delay_not_tested(flight: Flight) -> Finding:
    moves = [note.text for note in flight.notes if note.code == "clocks_placed"]
    stand = moves[-1] if moves else "its commands stand where they are answered as the model says"
    return Finding(
        "delay_not_tested",
        "info",
        f"only the answers to commands relate the clocks of {flight.path}, or of the flights that were fitted: {stand}",
        "whether the delay is that of the model, this flight cannot tell",
        "record the vehicle's own velocity or heading beside the commands and name it in the card, or write "
        'clock = "one" there if the clocks are one',
    )


def _touched(misread: Sequence[Finding]) -> set[str | None]:
    """The axes that findings spoil, or None for all: x and y share a filter."""
    axes = {finding.axis for finding in misread}
    return axes | {"x", "y"} if axes & {"x", "y"} else axes


def paper_dynamics(model: Model, flight: Flight | None = None) -> dict[str, AxisDynamics]:
    """Dynamics that predictions with the paper's coefficients need: the law without delay, with a filter of its own.

    They are those of a model by method `paper` of the same flights. Axes without coefficients from the regression, or
    of which the model knows nothing (there the regression fits noise), are only tracked, and yaw is taken as measured.

    Args:
        model: The model.
        flight: As for `dynamics_from_model`.
    """
    axes = {}
    for k, (name, axis) in enumerate(model.axes.items()):
        g, b = model.paper[2 * k : 2 * k + 2]
        point = None if g is None or b is None or axis.predictor is None else Predictor(g, b, 0.0)
        noise = model.paper_noise.get(name, axis.noise)
        axes[name] = replace(axis, predictor=point, noise=noise, structure=FIRST_ORDER_DELAY.name)
    return dynamics_from_model(replace(model, axes=axes), flight)


def _score_flight(
    model: Model, flight: Flight, horizons: Sequence[float], report: Callable[[float], None]
) -> tuple[dict[str, tuple[FlightScores, dict[str, StartErrors]]], dict[str, dict[str, BandScore]]]:
    """Scores of the model's predictions and of all baselines on one flight, with the errors behind them; the bands.

    The predictions of half an hour take hundreds of megabytes: they are scored and dropped piece by piece.

    Args:
        model: The model.
        flight: The flight.
        horizons: Prediction horizons [s].
        report: Called with the completed share.
    """
    coefficients = np.array([np.nan if g is None else g for g in model.paper])
    coasting = np.nan_to_num(coefficients.reshape(4, 2).T)
    errors: dict[str, list[Errors]] = {name: [] for name in ("model", *BASELINES)}
    bands: dict[float, list[Stated]] = {horizon: [] for horizon in horizons}
    (begin, end), longest = flight.span, max(horizons)

    def of_regression(dynamics: Mapping[str, AxisDynamics]) -> list[Errors]:
        return [judged(part, part.predicted, horizons) for part in predictions(flight, dynamics, longest)]

    report(0.0)
    paper = paper_dynamics(model, flight)
    regressed = parallel.each(of_regression, [paper], flight.duration)
    for part in predictions(flight, dynamics_from_model(model, flight), longest):
        errors["model"].append(judged(part, part.predicted, horizons))
        errors["hold"].append(judged(part, hold_velocity(part), horizons))
        errors["coast"].append(judged(part, free_run_prediction(flight, part, *coasting), horizons))
        for horizon, each in bands.items():
            each.append(stated(part, horizon))
        report(0.5 * (part.start[-1] - begin) / (end - begin))
    errors["paper"] = next(regressed)
    report(0.8)

    known = np.array([model.axes[axis].predictor is not None for axis in AXES])
    wanted = dict.fromkeys(errors, np.isfinite(coefficients[::2]) & known)
    wanted |= {"model": known, "hold": np.ones(4, bool)}
    turning = dict.fromkeys(errors, bool(known[AXES.index("yaw")])) | {"paper": "yaw" in paper}
    empty = AxisScore({f"{h:g}": Horizon(None, None, 0) for h in horizons}, None)
    fitted, turned, out = was_fitted(model, flight), _turn(flight), {}
    for name, pieces in errors.items():
        every = joined(pieces, horizons)
        axes = {a: score if wanted[name][k] else empty for k, (a, score) in enumerate(scores_of(every).items())}
        heading: Literal["predicted", "measured"] = "predicted" if turning[name] else "measured"
        scores = FlightScores(flight.path, flight.span, axes, heading, fitted, flight.moved, turned, flight.held)
        out[name] = scores, {f"{h:g}": _known_errors(each, wanted[name]) for h, each in every.starts.items()}
    return out, band_scores(bands)


def horizon_scores(model: Model, flight: Flight, horizon: float) -> tuple[Mapping[str, Horizon], Mapping[str, Horizon]]:
    """Errors at one horizon [s] of the model and of holding the velocity; the same numbers as from `validate`."""
    judge, own, held = (horizon,), [], []
    for part in predictions(flight, dynamics_from_model(model, flight), horizon):
        own.append(judged(part, part.predicted, judge))
        held.append(judged(part, hold_velocity(part), judge))
    errors, hold = (
        {axis: score.horizons[f"{horizon:g}"] for axis, score in scores_of(joined(each, judge)).items()}
        for each in (own, held)
    )
    nothing = Horizon(None, None, 0)
    return {axis: one if model.axes[axis].predictor else nothing for axis, one in errors.items()}, hold


def _known_errors(errors: StartErrors, wanted: Array) -> StartErrors:
    """Replaces the errors of axes without a model by NaN."""
    velocity, position = (np.where(wanted, values, np.nan) for values in (errors.velocity, errors.position))
    return replace(errors, velocity=velocity, position=position)


def to_mapping(validation: Validation) -> dict[str, Any]:
    """The validation as plain JSON types."""
    return {
        "flights": [asdict(flight) for flight in validation.flights],
        "baselines": {
            name: {"flights": [asdict(flight) for flight in flights]} for name, flights in validation.baselines.items()
        },
        "paired": [asdict(test) for test in validation.paired],
        "residuals": [
            {"path": flight.path, "axes": {axis: asdict(tests) for axis, tests in axes.items()}}
            for flight, axes in zip(validation.flights, validation.residuals, strict=True)
        ],
        "frequency_response": [
            {"path": flight.path, "axes": {axis: response_mapping(each) for axis, each in axes.items()}}
            for flight, axes in zip(validation.flights, validation.responses, strict=False)
        ],
        "bands": [
            {
                "path": flight.path,
                "axes": {
                    axis: {key: asdict(score) for key, score in horizons.items()} for axis, horizons in axes.items()
                },
            }
            for flight, axes in zip(validation.flights, validation.bands, strict=False)
        ],
        "findings": [asdict(finding) for finding in validation.findings],
    }
