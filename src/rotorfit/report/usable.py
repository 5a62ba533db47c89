"""Scores and paired tests -> is the model usable for predictions that far ahead, axis by axis and as a whole?"""

from collections.abc import Sequence
from dataclasses import dataclass

from rotorfit.evidence import Score
from rotorfit.forecast import HORIZONS
from rotorfit.frames import AXES
from rotorfit.paired import QUANTITIES, Difference, PairedTest

USEFUL = 2.0
"""How many times smaller than those of holding the velocity the errors must be to be called usable."""

USELESS = 1.1
"""Below this they are no smaller."""

RANK = ("yes", "limited", "unproven", "no", "missing")
"""Answers from the best to the worst."""


@dataclass(frozen=True)
class Use:
    """Whether an axis is usable at a horizon.

    Attributes:
        axis: Name; `all` for the weakest of the axes.
        horizon: [s].
        answer: `yes`, `limited`, `unproven`, `no`, or `missing` where there is no model.
        reason: Why it is not `yes`; empty where it is.
        velocity: RMSE over all steps up to the horizon [m/s or rad/s]; None where it was not scored.
        position: RMSE at its end [m or rad]; None likewise.
        times: How many times smaller both are than those of holding the velocity: the smaller of the two ratios.
        n: Predictions.
    """

    axis: str
    horizon: float
    answer: str
    reason: str
    velocity: float | None = None
    position: float | None = None
    times: float | None = None
    n: int = 0


def uses_of(
    scores: Sequence[Score], paired: Sequence[PairedTest], known: Sequence[str], horizons: Sequence[float] = HORIZONS
) -> tuple[Use, ...]:
    """Answers for every axis at every horizon.

    `yes`: on flights that were not fitted and command the axis, the errors of velocity and position are both at most
    half of those of holding the velocity, and the paired test shows both differences to be real at 95 %. `limited`:
    better, but less than that, or not shown to be real. `no`: below 1.1 times better, or shown to be worse.
    `unproven`: no score.

    Args:
        scores: As `evidence.scores_of` gives them.
        paired: Of the model against the baselines.
        known: The axes that have a model.
        horizons: That are asked about [s].
    """
    by_place = {(score.axis, f"{score.horizon:g}"): score for score in scores}
    against = next((test for test in paired if test.second == "hold"), None)
    out = []
    for axis in AXES:
        for horizon in horizons:
            score = by_place.get((axis, f"{horizon:g}"))
            if axis not in known:
                out.append(Use(axis, horizon, "missing", "there is no model of it"))
            elif score is None:
                out.append(Use(axis, horizon, "unproven", "no flight that was not fitted moves this axis"))
            elif score.velocity.get("model") is None:
                out.append(Use(axis, horizon, "unproven", "no flight that was not fitted moves it for long enough"))
            else:
                out.append(_use(score, against))
    return tuple(out)


def _use(score: Score, against: PairedTest | None) -> Use:
    ratios = {what: _ratio(score, what) for what in QUANTITIES}
    known = [ratio for ratio in ratios.values() if ratio is not None]
    times = min(known, default=None)
    tested = against.axes[score.axis].get(f"{score.horizon:g}", {}) if against else {}
    found = [tested[what].pooled if what in tested else None for what, ratio in ratios.items() if ratio is not None]
    answer, reason = _answer(times, found)
    velocity, position = score.velocity.get("model"), score.position.get("model")
    return Use(score.axis, score.horizon, answer, reason, velocity, position, times, score.n)


def _ratio(score: Score, what: str) -> float | None:
    errors = score.velocity if what == "velocity" else score.position
    own, hold = errors.get("model"), errors.get("hold")
    return None if own is None or hold is None else hold / own if own > 0 else float("inf")


def _answer(times: float | None, found: Sequence[Difference | None]) -> tuple[str, str]:
    """Answer and reason by the ratio and the tests of both quantities."""
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
        return "limited", f"only {times:.1f} times better than holding the velocity; the flights may hardly move it"
    return "yes", ""


def weakest(uses: Sequence[Use], axes: Sequence[str]) -> tuple[Use, ...]:
    """The model as a whole, horizon by horizon: its weakest axis, with that one's numbers."""
    out = []
    for horizon in sorted({use.horizon for use in uses}):
        here = [use for use in uses if use.horizon == horizon and use.axis in axes]
        if here:
            out.append(max(here, key=lambda use: (RANK.index(use.answer), -(use.times or 0.0))))
    return tuple(out)


def reach(uses: Sequence[Use]) -> float | None:
    """The longest horizon up to which every answer is `yes` [s]; None where the first is not."""
    longest = None
    for use in sorted(uses, key=lambda use: use.horizon):
        if use.answer != "yes":
            break
        longest = use.horizon
    return longest
