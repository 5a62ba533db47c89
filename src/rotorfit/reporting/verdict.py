"""From scores and tests to a verdict: can this model be used for predictions, and how far ahead?

It is given for each axis and for the model as a whole, in plain words, with traffic lights that agree with every test.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from rotorfit.assessment.evidence import Evidence
from rotorfit.assessment.paired import QUANTITIES
from rotorfit.assessment.rows import LENGTH, SPEED, HorizonErrors
from rotorfit.assessment.whiteness import FINDING_LEVEL, LEVEL, has_own_coefficients, narrows_intervals
from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.model import FROZEN, Axis, Model
from rotorfit.core.residuals import ResidualTests
from rotorfit.core.results import HORIZONS, Difference, PairedTest
from rotorfit.estimation.methods import maximises_likelihood
from rotorfit.reporting.targets import beside_target
from rotorfit.reporting.words import and_list, chance, figure, sentences, term_of

USEFUL = 2.0
"""Least ratio of the errors of holding the velocity to those of a usable model."""

USELESS = 1.1
"""Ratio below which the model's errors count as no smaller."""

OVERLAPS = "the flight that moves this axis overlaps the training, and so proves nothing"
"""Reason of an axis that only flights of the fit move."""

RANK = ("yes", "limited", "unproven", "no", "missing")
"""Answers, from the best to the worst."""


@dataclass(frozen=True)
class Use:
    """Whether an axis is usable at a horizon.

    Attributes:
        axis: Name of the axis; `all` for the weakest one.
        horizon: Horizon [s].
        answer: `yes`, `limited`, `unproven`, `no`, or `missing` without a model.
        reason: Why it is not `yes`; otherwise empty.
        velocity: RMSE of the velocity over all steps up to the horizon [m/s or rad/s]; None if it was not scored.
        position: RMSE of the position at the horizon [m or rad]; None if it was not scored.
        times: Ratio of the errors of holding the velocity to the model's, the smaller one of velocity and position.
        n: Number of predictions.
        remedy: What to do first, if the flights cannot judge the model; otherwise empty.
    """

    axis: str
    horizon: float
    answer: str
    reason: str
    velocity: float | None = None
    position: float | None = None
    times: float | None = None
    n: int = 0
    remedy: str = ""


def uses_of(
    scores: Sequence[HorizonErrors],
    paired: Sequence[PairedTest],
    known: Sequence[str],
    horizons: Sequence[float] = HORIZONS,
    misread: Sequence[Finding] = (),
    spent: Collection[str] = (),
) -> tuple[Use, ...]:
    """Answers for every axis at every horizon.

    `yes`: on flights that were not fitted and command the axis, the errors of velocity and position are both at most
    half of those of holding the velocity, and both differences are significant at 95 % in the paired test. `limited`:
    better, but by less, or not significantly. `no`: less than 1.1 times better, or significantly worse. `unproven`: no
    score, or one of a flight whose data cannot judge the model.

    Args:
        scores: As `scores_of` gives them.
        paired: Paired tests of the model against the baselines.
        known: The axes that have a model.
        horizons: Horizons of the answers [s].
        misread: Errors, or doubts, about how these flights are read.
        spent: The axes that only flights of the fit move.
    """
    by_place = {(score.axis, f"{score.horizon:g}"): score for score in scores}
    against = next((test for test in paired if test.second == "hold"), None)
    out = []
    for axis in AXES:
        wrong = next((finding for finding in misread if finding.axis in (axis, None)), None)
        for horizon in horizons:
            score = by_place.get((axis, f"{horizon:g}"))
            if axis not in known:
                out.append(Use(axis, horizon, "missing", "there is no model of it"))
            elif score is None:
                reason = OVERLAPS if axis in spent else "no flight that was not fitted moves this axis"
                out.append(Use(axis, horizon, "unproven", reason))
            elif score.velocity.get("model") is None:
                out.append(Use(axis, horizon, "unproven", "no flight that was not fitted moves it for long enough"))
            elif wrong:
                out.append(Use(axis, horizon, "unproven", wrong.evidence, remedy=wrong.remedy))
            else:
                out.append(_use(score, against))
    return tuple(out)


def _use(score: HorizonErrors, against: PairedTest | None) -> Use:
    ratios = {what: _times_better(score, what) for what in QUANTITIES}
    known = [ratio for ratio in ratios.values() if ratio is not None]
    times = min(known, default=None)
    tested = against.axes[score.axis].get(f"{score.horizon:g}", {}) if against else {}
    found = [tested[what].pooled if what in tested else None for what, ratio in ratios.items() if ratio is not None]
    answer, reason = _answer(times, found)
    velocity, position = score.velocity.get("model"), score.position.get("model")
    return Use(score.axis, score.horizon, answer, reason, velocity, position, times, score.n)


def _times_better(score: HorizonErrors, what: str) -> float | None:
    errors = score.velocity if what == "velocity" else score.position
    own, hold = errors.get("model"), errors.get("hold")
    return None if own is None or hold is None else hold / own if own > 0 else float("inf")


def _answer(times: float | None, found: Sequence[Difference | None]) -> tuple[str, str]:
    """Answer and reason from the ratio and the tests of both quantities."""
    verdicts = ["too_short" if each is None else each.verdict for each in found]
    if times is None:
        return "unproven", "there is nothing to compare with"
    if times < USELESS or "worse" in verdicts:
        return "no", "it predicts no better than holding the velocity"
    if "too_short" in verdicts:
        return "limited", "the flights are too short to show that the difference from holding the velocity is real"
    if "no_difference_shown" in verdicts:
        return "limited", "the difference from holding the velocity is not shown to be real at 95 %"
    if times < USEFUL:
        return "limited", f"less than {USEFUL:g} times better than holding the velocity; the flights may hardly move it"
    return "yes", ""


def weakest(uses: Sequence[Use], axes: Sequence[str]) -> tuple[Use, ...]:
    """The model as a whole at each horizon: its weakest axis, with the numbers of that axis."""
    out = []
    for horizon in sorted({use.horizon for use in uses}):
        here = [use for use in uses if use.horizon == horizon and use.axis in axes]
        if here:
            out.append(max(here, key=lambda use: (RANK.index(use.answer), -(use.times or 0.0))))
    return tuple(out)


def reach(uses: Sequence[Use]) -> float | None:
    """The longest horizon up to which every answer is `yes` [s]; None if the first is not."""
    longest = None
    for use in sorted(uses, key=lambda use: use.horizon):
        if use.answer != "yes":
            break
        longest = use.horizon
    return longest


PLANNING = 1.0
"""Horizon of the headline [s]."""

COLOUR = {"yes": "green", "limited": "yellow", "unproven": "open", "no": "red", "missing": "grey"}
"""Answer to the colour of the lamp for predictions; `open` is an unlit lamp with a question mark."""

EQUAL = "1.0"
"""Text of a factor that is neither better nor worse."""

DOUBT = 0.01
"""p-value above which a test that fails at 95 % is only weak evidence: a model has several tests."""

OTHER = 4.0
"""Ratio of the variance of the innovations to that of the fit from which the intervals are doubted: standard deviations
are then twice what the fit assumed; or half, below the inverse."""

MOST_REASONS = 2
"""Largest number of reasons beside a lamp; the rest are among the findings."""

PROOF = {
    "limited": "use it where the errors of the table are small enough for you, and fly a longer or livelier proof",
    "unproven": "fly a flight that moves the axis, keep it out of the fit, and report again",
}
"""Answer to the advice that it calls for."""

GAPS = "use it to predict, but do not read the coefficients that are doubted one by one"
"""Advice on an axis with unknown coefficients."""

TOO_SURE = "an estimator that takes its noise for white is too sure: give it more"
"""Advice on coloured residuals, for a filter."""

SHORT = "Enough to predict; tuned gains allow for the rest by being slower, as standard errors exceed the targets"
"""What is said of known coefficients that miss the targets of a controller."""

GRAVITY = ("red", "grey", "open", "yellow", "green")
"""Colours, from the worst to the best."""

STATUS = {
    "not_excited": "its commands explain nothing of the motion",
    "not_fitted": "the fit left the axis out",
    "too_short": "there is too little data",
    "diverged": "the estimation found no optimum",
    "not_identifiable": "the data do not separate it from the other coefficients",
    "refuted": "the flights deny the law that it belongs to",
    FROZEN: "the pose stands still while the axis is commanded",
}


@dataclass(frozen=True)
class Lamp:
    """One question about an axis: `green`, `yellow`, `red`, `open` (not proven) or `grey` (nothing to ask).

    `advice` says what to do if the axis is used in spite of a doubt; empty if there is none.
    """

    question: str
    colour: str
    word: str
    text: str
    advice: str = ""


@dataclass(frozen=True)
class Light:
    """The verdict on one axis.

    Attributes:
        axis: Name of the axis.
        colour: The worst colour of its lamps.
        word: The verdict in a few words.
        error: Velocity error at the planning horizon, with its unit; None if it was not scored.
        sentences: How well it predicts.
        lamps: Lamps for predictions, coefficients and residuals.
        missed: Its coefficients that miss the targets of a controller.
    """

    axis: str
    colour: str
    word: str
    error: str | None
    sentences: tuple[str, ...]
    lamps: tuple[Lamp, ...]
    missed: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """The verdict on a model, the first thing that a reader sees.

    Attributes:
        headline: The answer at the planning horizon.
        whole: The answer for all axes together, one or two sentences.
        advice: What to do about each doubt, one sentence each.
        horizon: The planning horizon [s].
        lights: The lights of x, y, z, yaw.
        uses: Answers for every axis at every horizon.
        weakest: Answers for the weakest axis at every horizon.
    """

    headline: str
    whole: str
    advice: tuple[str, ...]
    horizon: float
    lights: tuple[Light, ...]
    uses: tuple[Use, ...]
    weakest: tuple[Use, ...]


def verdict_on(evidence: Evidence, speeds: Mapping[str, float] | None = None) -> Verdict:
    """The verdict on a model from its evidence; the flights of the fit do not count.

    Args:
        evidence: Evidence of the model.
        speeds: As for `verdict_of`.
    """
    validation = evidence.case.validation
    scored = zip(validation.flights, validation.residuals, strict=False)
    residuals = [tests for flight, tests in scored if not flight.fitted]
    return verdict_of(
        evidence.case.model,
        evidence.scores,
        validation.paired,
        residuals,
        speeds,
        validation.before_scores,
        validation.spent,
    )


def verdict_of(
    model: Model,
    scores: Sequence[HorizonErrors],
    paired: Sequence[PairedTest] = (),
    residuals: Sequence[Mapping[str, ResidualTests]] = (),
    speeds: Mapping[str, float] | None = None,
    misread: Sequence[Finding] = (),
    spent: Collection[str] = (),
) -> Verdict:
    """Judges a model by its scores on validation flights, its statuses, its findings and the tests of its residuals.

    Each axis has three lamps. Predictions: see `uses_of`, at the planning horizon. Coefficients: green if all are known
    and no finding warns of them, including findings about the residuals; those that miss the targets of a controller
    are named, in the headline, too. Residuals: green if no test rejects the model at 95 %. The light of the axis is the
    worst of the three.

    Args:
        model: The model, with its findings.
        scores: As `scores_of` gives them.
        paired: Paired tests of the model against the baselines.
        residuals: Axis to its tests, one mapping for each flight that was not fitted.
        speeds: Axis to the speed up to which it was tested [m/s or rad/s].
        misread: `Validation.before_scores` of the flights: what they touch is not proven, whatever the scores.
        spent: The axes that only flights of the fit move.
    """
    known = [axis for axis in AXES if model.axes[axis].predictor is not None]
    uses = uses_of(scores, paired, known, misread=misread, spent=spent)
    horizon = min({use.horizon for use in uses}, key=lambda h: abs(h - PLANNING))
    lights = tuple(
        _light(
            model, axis, [use for use in uses if use.axis == axis], horizon,
            [score for score in scores if score.axis == axis],
            [each[axis] for each in residuals if axis in each],
            (speeds or {}).get(axis),
        )
        for axis in AXES
    )  # fmt: skip
    wanted = [axis for axis in AXES if axis in model.card.command or axis in known]
    together = weakest(uses, wanted)
    left_out = [axis for axis in wanted if model.axes[axis].status["input"] == "not_fitted"]
    whole = _whole(lights, together, uses, wanted, horizon, left_out)
    return Verdict(_headline(lights), whole, _advice(lights), horizon, lights, uses, together)


def _light(
    model: Model,
    axis: str,
    uses: Sequence[Use],
    horizon: float,
    scores: Sequence[HorizonErrors],
    tests: Sequence[ResidualTests],
    speed: float | None,
) -> Light:
    known, use = model.axes[axis], next(use for use in uses if use.horizon == horizon)
    if known.predictor is None:
        status = known.status["input"]
        colour = "red" if status == "diverged" else "grey"
        (reason,) = sentences([STATUS.get(status, "no numbers")])
        return Light(axis, colour, "no model", None, (), (Lamp("coefficients", colour, "unknown", reason),))
    unjudged = Lamp("residuals", "grey", "not judged", "Nor are the predictions.")
    lamps = (
        _predictions(use),
        _coefficients(model, axis),
        unjudged if use.remedy else _residuals(tests, untried(model, axis)),
    )
    colour = min((lamp.colour for lamp in lamps if lamp.colour != "grey"), key=GRAVITY.index)
    unit, factor = SPEED[axis]
    error = None if use.velocity is None else f"{figure(factor * use.velocity)} {unit}"
    said = [] if use.velocity is None else _sentences(use, uses, scores, model.method)
    if use.velocity is not None and speed is not None:
        said.append(f"tested at up to {_speed(axis, speed)}")
    word, told = _word(colour, reach(uses)), sentences([*said, *_answers(known)])
    return Light(axis, colour, word, error, told, lamps, tuple(_missed(model, axis)))


def _word(colour: str, furthest: float | None) -> str:
    upto = "" if furthest is None else f" up to {furthest:g} s"
    return {"green": f"usable{upto}", "yellow": f"with care{upto and ',' + upto}", "open": "not proven"}.get(
        colour, "do not use"
    )


def _predictions(use: Use) -> Lamp:
    words = {"yes": "proven", "limited": "partly", "unproven": "not proven", "no": "useless"}
    (text,) = sentences([use.reason or f"errors at most 1/{USEFUL:g} of holding the velocity, and that is no chance"])
    return Lamp("predictions", COLOUR[use.answer], words[use.answer], text, use.remedy or PROOF.get(use.answer, ""))


def _coefficients(model: Model, axis: str) -> Lamp:
    """Lamp for the coefficients: whether they are known and no finding warns of them."""
    mine = [f for f in model.findings if f.axis in (axis, None) and f.code != "converted"]  # of the flights, not them
    forbidden = [f.evidence for f in mine if f.severity == "error"]
    early = any(f.code == "delay_negative" for f in mine)
    gaps = [*_unknown(model.axes[axis], model.method), *_early(model.axes[axis], early)]
    warnings = [f for f in mine if f.severity == "warning"]
    told = list(dict.fromkeys([*forbidden, *gaps, *(f.effect if _of_residuals(f) else f.evidence for f in warnings)]))
    if told:
        more = f" {len(told) - MOST_REASONS} more under Findings." if len(told) > MOST_REASONS else ""
        word = "unusable" if forbidden else "in part" if gaps else "known, with a warning"
        # Advice about the residuals is given by their own lamp.
        asked = [*([GAPS] if gaps else []), *(f.remedy for f in warnings if not _of_residuals(f))]
        text = " ".join(sentences(told[:MOST_REASONS])) + more
        return Lamp("coefficients", "red" if forbidden else "yellow", word, text, "; ".join(asked[:1]))
    text, missed = "Each has an interval, and no finding warns.", _missed(model, axis)
    if not missed:
        return Lamp("coefficients", "green", "known", text)
    by = and_list([f"{term_of(name)} {figure(share)} times" for name, share in missed.items()])
    return Lamp("coefficients", "green", "known, short of targets", f"{text} {SHORT}: {by}.")


def _missed(model: Model, axis: str) -> dict[str, float]:
    """Coefficients of an axis whose standard errors exceed the targets of a controller, and the ratios to these."""
    if not maximises_likelihood(model.method):
        return {}
    return {name: share for name, share in beside_target(model.axes[axis]).items() if share > 1}


def _residuals(tests: Sequence[ResidualTests], richer: bool) -> Lamp:
    """Lamp for the residuals: whether a test on any flight rejects the model at 95 %, or their variance has changed.

    Args:
        tests: Of flights that were not fitted.
        richer: Whether a richer law could be chosen, and none was tried.
    """
    found = [(each.white_p, "not white") for each in tests]
    found += [(each.command_p, "following past commands") for each in tests if each.command_p is not None]
    if not found:
        return Lamp("residuals", "grey", "not tested", "No flight that was not fitted moves this axis for long enough.")
    against = sorted(each for each in found if each[0] < LEVEL)
    ratios = [each.variance_ratio for each in tests if not 1 / OTHER <= each.variance_ratio <= OTHER]
    if not against and ratios:
        told = ", ".join(f"{ratio:.2g}" for ratio in ratios)
        text = f"their variance is {told} times that of the fit, whose intervals assume other wind and noise"
        widest = max(ratios) ** 0.5
        more = f"use it, but multiply the standard deviations of the noise in your estimator by {figure(widest)}"
        advice = more if widest > 1 else "use it; wind and noise are less here than in the fit, and so are the errors"
        return Lamp("residuals", "yellow", "of other size", sentences([text])[0], advice)
    if not against:
        return Lamp("residuals", "green", "clean", f"{len(found)} tests, the smallest {chance(min(found)[0])}.")
    follows = [each for each in against if each[1] != "not white" and each[0] < FINDING_LEVEL]
    p, what = (follows or against)[0]
    if p >= DOUBT:
        text = f"{what} ({chance(p)}): weak evidence, of tests of a right model one in 20 falls below 0.05"
        advice = "use it; this may be chance, and another flight that is not fitted will tell"
        return Lamp("residuals", "yellow", "in doubt", sentences([text])[0], advice)
    own = all(has_own_coefficients(each) for each in tests if each.follows_command)
    means = (
        "the vehicle answered by other coefficients than the model's, which leave nothing: it differed, or its answer "
        "depends on the size or speed of the commands"
        if own
        else "the model leaves out part of the answer, other motion may be predicted worse"
    )
    answers = what != "not white"
    text = f"{what} ({chance(p)}): {means if answers else 'something regular is left that the commands do not explain'}"
    advice = _with_residuals(tests, answers, own, richer)
    if ratios and max(ratios) > OTHER:
        text += f"; their variance is up to {max(ratios):.2g} times that of the fit"
        advice += f"; multiply the standard deviations of its noise by {figure(max(ratios) ** 0.5)}"
    return Lamp("residuals", "yellow", "not clean", sentences([text])[0], advice)


def _with_residuals(tests: Sequence[ResidualTests], follows: bool, own: bool, richer: bool) -> str:
    """What to do with a model whose residuals are not clean.

    Args:
        tests: Of flights that were not fitted.
        follows: Whether the residuals follow the commands.
        own: Whether coefficients of the flights' own leave nothing that follows.
        richer: Whether a richer law could be chosen, and none was tried.
    """
    if follows and own:
        return (
            "use it for motion like that of the fit, and fit it together with this flight: several tell how much "
            "flights differ"
        )
    if follows:
        more = "; for other motion let a richer law try, see below" if richer else ""
        return f"use it for motion like that of these flights only{more}"
    factor = max((max(each.optimism.values(), default=1.0) for each in tests if narrows_intervals(each)), default=1.0)
    if factor > 1:
        return f"use it, but multiply the half widths of its intervals by {factor:.2f}; {TOO_SURE}"
    return f"use it, its intervals hold; {TOO_SURE}"


def _of_residuals(finding: Finding) -> bool:
    return finding.code.startswith("residuals_")


def untried(model: Model, axis: str) -> bool:
    """Whether a richer law of an axis could be chosen, and none was tried."""
    return maximises_likelihood(model.method) and not model.axes[axis].candidates


def _advice(lights: Sequence[Light]) -> tuple[str, ...]:
    """The advice on the doubts, each once with the axes that it concerns; only for axes that are usable at all."""
    by: dict[str, list[str]] = {}
    for light in lights:
        for lamp in light.lamps if light.colour in ("yellow", "open") else ():
            if lamp.advice:
                by.setdefault(lamp.advice, []).append(light.axis)
    return tuple(f"{and_list(axes)}: {advice}." for advice, axes in by.items())


def _unknown(known: Axis, method: str) -> list[str]:
    """Coefficients without numbers."""
    by: dict[str, list[str]] = {}
    for name, status in known.status.items():
        if status != "ok" and not (method == "paper" and name == "delay"):
            by.setdefault(status, []).append(name)
    told = [
        f"{and_list(names)} {'is' if len(names) == 1 else 'are'} not identifiable alone: {STATUS.get(status, status)}"
        for status, names in by.items()
    ]
    if method == "paper":
        told.append("the paper's method knows no delay: it predicts as if commands acted at once")
    return told


def _early(known: Axis, told: bool) -> list[str]:
    """A delay that no vehicle can have, unless a finding reports it."""
    if told or known.delay is None or known.delay >= 0:
        return []
    high = known.ci95["delay"][1]
    reaches = "" if high is None else f"; up to {high:.2f} s belongs to its interval"
    return [f"the delay is {known.delay:.3f} s: no vehicle answers before its command{reaches}"]


def _answers(known: Axis) -> list[str]:
    """The delay, or else the total lag, in words; empty if neither is known."""
    if known.delay is not None and known.delay < 0:
        return [f"by the stamps a command acts {-known.delay:.2f} s before it is sent"]
    if known.delay is not None:
        low, high = known.ci95["delay"]
        ends = "" if low is None or high is None else f" ({max(low, 0.0):.2f} to {high:.2f} s)"
        return [f"the motion answers a command after {known.delay:.2f} s{ends}"]
    lag = known.combinations.get("total_lag")
    return [f"the motion trails its command by {lag.value:.2f} s"] if lag is not None and None not in lag.ci95 else []


def _sentences(use: Use, uses: Sequence[Use], scores: Sequence[HorizonErrors], method: str) -> list[str]:
    """Prediction errors at the planning horizon and at the longest one scored, compared with the baselines."""
    last = max((each for each in uses if each.velocity is not None), key=lambda each: each.horizon)
    said = [
        f"{over(each.horizon)}: off by {_off(each)}{better(each.times)}"
        for each in ([use, last] if last.horizon > use.horizon else [use])
    ]
    now = next(score for score in scores if score.horizon == use.horizon)
    paper = now.velocity.get("paper")
    if paper is not None and use.velocity and method != "paper":
        said.append(f"beside the paper's coefficients: velocity {_ratio(paper / use.velocity)}")
    return said


def errors_text(use: Use) -> str:
    """Velocity and position error with units, such as `1.7 cm/s and 0.85 cm`."""
    unit, factor = SPEED[use.axis]
    assert use.velocity is not None
    speed = f"{figure(factor * use.velocity)} {unit}"
    return speed if use.position is None else f"{speed} and {_length(use.axis, use.position)}"


def over(horizon: float) -> str:
    """The period of a velocity error, such as `over the first second`: the error is the RMS of all steps."""
    return "over the first second" if horizon == 1 else f"over the first {horizon:g} s"


def _off(use: Use) -> str:
    speed, *length = errors_text(use).split(" and ")
    return speed + "".join(f", and {each} at the end" for each in length)


def _length(axis: str, position: float) -> str:
    unit, factor = LENGTH[axis]
    return f"{figure(factor * position)} {unit}"


def _speed(axis: str, speed: float) -> str:
    return f"{figure(SPEED['yaw'][1] * speed)} deg/s" if axis == "yaw" else f"{figure(speed)} m/s"


def better(times: float | None) -> str:
    """Comparison with holding the velocity, to be appended to a sentence."""
    if times is None:
        return ""
    word, size = ("better", times) if times >= 1 else ("worse", 1 / times)
    if figure(size) == EQUAL:
        return ", equal to holding the velocity"
    return f", {figure(size)} times {word} than holding the velocity"


def _ratio(times: float) -> str:
    word, size = ("better", times) if times >= 1 else ("worse", 1 / times)
    return "equal" if figure(size) == EQUAL else f"{figure(size)} times {word}"


def _headline(lights: Sequence[Light]) -> str:
    """The answer for all axes, ordered as yes, with care, not proven, no, no model."""
    by = {colour: [light.axis for light in lights if light.colour == colour] for colour in GRAVITY}
    if len(by["grey"]) == len(lights):
        return "There is no model yet: no axis has numbers."
    words = {"green": "yes", "yellow": "with care", "open": "not proven", "red": "no"}
    parts = [f"{word} for {and_list(by[colour])}" for colour, word in words.items() if by[colour]]
    if len(parts) == 1 and not by["grey"]:
        parts = [f"{parts[0].partition(' for ')[0]}, for every axis"]
    missing = f" There is no model of {and_list(by['grey'])}." if by["grey"] else ""
    told = "; ".join(parts)
    short = [light for light in lights if light.colour == "green" and light.missed]
    targets = and_list([f"{and_list([term_of(name) for name in light.missed])} of {light.axis}" for light in short])
    beside = f" Known too little for the fastest controller: {targets}." if short else ""
    return f"{told[:1].upper()}{told[1:]}.{beside}{missing}"


def _whole(
    lights: Sequence[Light],
    together: Sequence[Use],
    uses: Sequence[Use],
    wanted: Sequence[str],
    horizon: float,
    left_out: Sequence[str],
) -> str:
    """The answer for all axes that the card commands, taken together."""
    if all(light.colour == "grey" for light in lights):
        return "Nothing can be predicted."
    now = next(use for use in together if use.horizon == horizon)
    lacking = [use for use in uses if use.horizon == horizon and use.answer == now.answer and use.axis in wanted]
    named, misread = and_list([use.axis for use in lacking]), [use.axis for use in lacking if use.remedy]
    if now.answer == "missing":
        why = f": the fit left out {and_list(left_out)}" if left_out else ""
        return f"As a whole: no. There is no model of {named}, which can be commanded{why}."
    if forbidden := _because([light for light in lights if light.axis not in misread], "red"):
        others = f" What concerns {and_list(misread)} may be misread, too: see the findings." if misread else ""
        return f"As a whole: no, because of {forbidden}.{others}"
    if misread:
        return (
            f"As a whole: not proven. The flights were or may be misread in what concerns {and_list(misread)}: see the "
            "findings."
        )
    if now.answer == "unproven":
        more = " What overlaps the training does not count." if any(u.reason == OVERLAPS for u in lacking) else ""
        return f"As a whole: not proven. No flight that was not fitted moves {named}, or not for long enough.{more}"
    doubted, furthest = _because(lights, "yellow"), reach(together)
    answer = f"with care, because of {doubted}" if doubted else "yes"
    upto = f". The predictions are proven up to {furthest:g} s" if furthest else ""
    return (
        f"As a whole: {answer}{upto}; {over(horizon)} the weakest axis is {now.axis}, off by {_off(now)}"
        f"{better(now.times)}."
    )


def _because(lights: Sequence[Light], colour: str) -> str:
    """The lamps of the axes that have a colour, such as `the residuals of y and z`."""
    by: dict[str, list[str]] = {}
    for light in lights:
        for lamp in light.lamps:
            if lamp.colour == colour:
                by.setdefault(lamp.question, []).append(light.axis)
    return and_list([f"the {question} of {and_list(axes)}" for question, axes in by.items()])
