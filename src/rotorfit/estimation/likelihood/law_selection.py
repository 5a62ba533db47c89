"""Selection of a structure for each axis, by the Bayesian information criterion and by predictions of held-out data.

The simplest structure is kept unless a richer one is better by both. Each flight in turn is held out, or each half of
the only one. Squared prediction errors of two structures are compared start by start, because the same gusts disturb
both; starts 0.5 s apart share most of the predicted interval, so standard errors are those of blocks longer than the
horizon. A structure is better if it is better block by block (by the logarithm of the ratio), so that a few large
errors do not dominate; to be no worse, its sum must be no worse, too. Residuals of real flights are not quite white:
the criterion scales the log-likelihood to the effective number of independent innovations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import FIRST_ORDER_DELAY, STRUCTURES, Structure
from rotorfit.core.model import Candidate, Combination
from rotorfit.dynamics.protocol import predict_flight, start_errors
from rotorfit.estimation.likelihood.axis_estimate import Estimate, free_of
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.combinations import delay_plus_lag
from rotorfit.estimation.likelihood.extra_parameters import separable
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.optima import between, dynamics_of, start_point, thinned
from rotorfit.estimation.likelihood.richer_laws import applicable_structure, single

AUTO = "auto"
"""Name that requests the selection."""

NEAR, FAR = 1.0, 5.0
"""Horizons at which predictions of velocity (near) and of the end point (far) are compared [s]."""

BLOCK = {NEAR: 5.0, FAR: 10.0}
"""Length of the blocks over which errors of starts are averaged [s]."""

NEGLIGIBLE_DELAY = 0.03
"""Longest possible delay at which a structure without a delay may be chosen [s]; else it would bias the damping."""

LEAST_BLOCKS = 4
"""Smallest number of blocks for a standard error; with fewer, predictions are not tested."""

VERY_STRONG = 10.0
"""Decrease of the criterion that counts as very strong evidence: for a delay, or where too little is held out to test.

Source: R. E. Kass, A. E. Raftery, J. Amer. Statist. Assoc. 90 (1995), pp. 773-795, section 3.2.
"""

OVERWHELMING = 50.0
"""Decrease of the criterion from which on predictions need not be surely better.

Of vehicles with delay and lag, a minute's flight gives 150 to 800 for the part that a law leaves out. At 10 to 50,
laws that predict better over 1 s where they are chosen predict the other half of recorded flights worse as often.
"""

LAGS = 20
"""Number of lags of the autocorrelation of the innovations that are used."""

SAME = "not identifiable: what it adds cannot be distinguished from its other parameters with these commands and gusts"
"""Verdict on a structure whose further parameters are not identifiable with these commands."""


NO_LIMIT = "rejected: the likelihood gain over second_order, which is the same without a limit, does not justify it"


@dataclass(frozen=True)
class Choice:
    """The structure chosen for an axis, and the candidates.

    Attributes:
        structure: The chosen structure.
        candidates: All structures that were tried, the default first.
        samples: Effective number of independent innovations.
        delay_plus_lag: Sum of delay and lag [s] under `first_order_delay_lag`, which is identifiable even where its
            parts are not.
    """

    structure: Structure
    candidates: tuple[Candidate, ...]
    samples: float
    delay_plus_lag: Combination


@dataclass(frozen=True)
class HeldOut:
    """Squared prediction errors on held-out data, one per start.

    Attributes:
        block: Label of the block of each start, by horizon [s], each of shape (n,).
        squares: Squared errors by horizon [s]: mean over the steps of the velocity (near), end point (far), shape (n,).
    """

    block: Mapping[float, Array]
    squares: Mapping[float, Array]

    def rmse(self, horizon: float) -> float | None:
        """Root mean square error at a horizon [s]; None without predictions."""
        values = self.squares[horizon]
        return float(np.sqrt(values.mean())) if values.size else None


@dataclass(frozen=True)
class _Trial:
    """One structure tried on one axis.

    Attributes:
        structure: The structure.
        log_likelihood: Log-likelihood less that of the default.
        bic: Information criterion less that of the default.
        held_out: Its prediction errors on held-out data.
        separable: Whether its further parameters are identifiable with these commands.
        neglected: Longest delay that the data allow, if the structure has none [s]; else 0.
        estimate: Estimate from all data.
    """

    structure: Structure
    log_likelihood: float
    bic: float
    held_out: HeldOut
    separable: bool
    neglected: float
    estimate: Estimate


def select_laws(serving: Sequence[Flight], estimates: Mapping[str, Estimate], axes: Sequence[str]) -> dict[str, Choice]:
    """Selects a structure for each axis of a group, while the other axes keep the default.

    Args:
        serving: The flights of the group.
        estimates: Estimates under the first-order law with a delay, by axis.
        axes: Axes to select for.
    """
    folds = _folds(serving)
    return {axis: _choice(serving, folds, estimates, axis) for axis in axes}


def _folds(serving: Sequence[Flight]) -> list[tuple[list[Flight], Flight]]:
    """Pairs of fitted flights and held-out flight: each flight in turn, or the halves of the only one."""
    parts = list(serving)
    if len(parts) == 1:
        start, end = parts[0].segments[0].start, parts[0].segments[-1].end
        middle = 0.5 * (start + end)
        parts = [between(parts[0], start, middle), between(parts[0], middle, end)]
    return [([other for other in parts if other is not part], part) for part in parts]


def _choice(
    serving: Sequence[Flight],
    folds: Sequence[tuple[Sequence[Flight], Flight]],
    estimates: Mapping[str, Estimate],
    axis: str,
) -> Choice:
    group = tuple(estimates)
    turns = estimates[axis].optimum.point.gain.size == 2
    names = [
        s
        for s in STRUCTURES.values()
        if axis in s.tried and applicable_structure(s, group) == s and (turns or not s.world)  # else as a plain lag
    ]
    samples, share = effective_samples(estimates[axis])
    trials = [_trial(serving, folds, estimates, axis, structure, samples, share) for structure in names]
    trials.sort(key=lambda trial: (trial.structure != FIRST_ORDER_DELAY, trial.structure.size))  # else as in the table
    best, verdicts = trials[0], [_Verdict(trials[0], trials[0], True, "the baseline")]
    within = {trial.structure.name: trial for trial in trials}
    for trial in trials[1:]:
        free = within.get("second_order") if trial.structure.limited else None
        if free and trial.bic >= free.bic:
            verdicts.append(_Verdict(trial, free, False, NO_LIMIT))
            continue
        verdicts.append(_verdict(trial, best, len(trials) - 1))
        best = trial if verdicts[-1].passed else best
    both = next(trial.estimate for trial in trials if trial.structure.name == "first_order_delay_lag")
    total = delay_plus_lag(both.records, both.optimum, both.place)
    return Choice(best.structure, tuple(_candidate(one, best) for one in verdicts), samples, total)


def effective_samples(estimate: Estimate) -> tuple[float, float]:
    """Effective number of independent innovations of an axis, and its share of all innovations.

    Source: M. S. Bartlett, J. R. Statist. Soc. 8 (1946), pp. 27-41: sums of products of a series with autocorrelation r
    vary 1 + 2 sum r^2 times as much as those of a white one.
    """
    k, total, products = estimate.place, 0, np.zeros(LAGS + 1)
    for innovation in estimate.optimum.score.innovations:
        e = innovation[:, k] - innovation[:, k].mean()
        total += e.size
        products += [float(e[: max(e.size - lag, 0)] @ e[lag:]) for lag in range(LAGS + 1)]
    correlation = products[1:] / products[0]
    correlation[np.abs(correlation) < 2 / np.sqrt(total)] = 0.0
    share = 1 / (1 + 2 * float(correlation @ correlation))
    return share * total, share


def _trial(
    serving: Sequence[Flight],
    folds: Sequence[tuple[Sequence[Flight], Flight]],
    estimates: Mapping[str, Estimate],
    axis: str,
    structure: Structure,
    samples: float,
    share: float,
) -> _Trial:
    """One structure, fitted to all data and to each fold."""
    before, after = single(serving, estimates, axis, structure)
    gained = after.optimum.score.log_likelihood - before.optimum.score.log_likelihood
    size = structure.size - FIRST_ORDER_DELAY.size
    held_out = _held_out(folds, after, axis)
    criterion = -2 * share * gained + size * float(np.log(samples))
    neglected = _longest_delay(before) if structure.size < FIRST_ORDER_DELAY.size else 0.0
    return _Trial(structure, gained, criterion, held_out, separable(after.optimum, after.place), neglected, after)


def _longest_delay(estimate: Estimate) -> float:
    """Largest absolute delay within two standard errors of the estimate [s]."""
    optimum, k = estimate.optimum, estimate.place
    place = 2 * optimum.point.gain.size + k
    variance = optimum.covariance[place, place]
    return float(abs(optimum.point.delay[k]) + 2 * np.sqrt(variance))


def _held_out(folds: Sequence[tuple[Sequence[Flight], Flight]], estimate: Estimate, axis: str) -> HeldOut:
    """Prediction errors on the held-out part of each fold, by the structure fitted to its other part."""
    axes, k = estimate.records[0].axes, AXES.index(axis)
    block: dict[float, list[Array]] = {NEAR: [], FAR: []}
    squares: dict[float, list[Array]] = {NEAR: [], FAR: []}
    for number, (fitted, held) in enumerate(folds):
        records = [rec for flight in fitted if (rec := record(flight, axes))]
        if not records or record(held, axes) is None:
            continue
        dynamics = dynamics_of(axes, _refitted(records, estimate.optimum))
        parts = predict_flight(thinned(held), dynamics, FAR, axes, adapt=False)
        for horizon in (NEAR, FAR):
            errors = start_errors(parts, [part.predicted for part in parts], horizon)
            with np.errstate(invalid="ignore"):
                values = (errors.velocity / errors.steps if horizon == NEAR else errors.position)[:, k]
            good = np.isfinite(values)
            squares[horizon].append(values[good])
            block[horizon].append(np.floor(errors.start[good] / BLOCK[horizon]) + 1e6 * number)
    joined = {
        h: (np.concatenate(block[h] or [np.empty(0)]), np.concatenate(squares[h] or [np.empty(0)])) for h in BLOCK
    }
    return HeldOut({h: one for h, (one, _) in joined.items()}, {h: one for h, (_, one) in joined.items()})


def _refitted(records: Sequence[Record], optimum: Optimum) -> Optimum:
    """The optimum on other records, climbed from the coefficients and levels of this one."""
    point = optimum.point
    fresh = start_point(records, 0.0, 1.0, point.levels)
    start = replace(point, trim=fresh.trim, start=fresh.start)
    K = point.gain.size
    moving = [bool(optimum.free[k]) for k in range(K)]
    free = free_of(records, moving, point.structures or (FIRST_ORDER_DELAY,) * K)
    return maximise(records, start, free, tolerance=0.05, linear=optimum.score.linear)


@dataclass(frozen=True)
class Change:
    """Change of squared errors relative to a rival's.

    Attributes:
        total: Mean difference over the rival's mean.
        total_error: Standard error of `total`.
        typical: Mean over the blocks of the logarithm of the ratio of both means, robust to a few large errors.
        typical_error: Standard error of `typical`.
        reach: Number of standard errors required for significance.
    """

    total: float
    total_error: float
    typical: float
    typical_error: float
    reach: float

    @property
    def better(self) -> bool:
        """Whether the errors are significantly smaller, and smaller in total."""
        return self.smaller and self.typical + self.reach * self.typical_error < 0

    @property
    def smaller(self) -> bool:
        """Whether the errors are smaller, typically and in total, be it by chance."""
        return self.typical < 0 and self.total < 0

    @property
    def no_worse(self) -> bool:
        """Whether neither `typical` nor `total` exceeds 0 by more than its standard error."""
        return self.typical <= self.typical_error and self.total <= self.total_error

    @property
    def words(self) -> str:
        """Both changes in per cent, with their standard errors, as text."""
        typical, error = float(np.expm1(self.typical)), self.typical_error * float(np.exp(self.typical))
        return (
            f"typically {100 * typical:+.1f} +- {100 * error:.1f} %, "
            f"in all {100 * self.total:+.1f} +- {100 * self.total_error:.1f} %"
        )


def change_of(one: HeldOut, rival: HeldOut, horizon: float, tries: int = 1) -> Change | None:
    """Change of squared errors relative to a rival's at a horizon [s]; None with too few blocks.

    Args:
        one: Errors of a structure.
        rival: Errors of its rival, at the same starts.
        horizon: `NEAR` or `FAR` [s].
        tries: Number of comparisons, for the Bonferroni correction.
    """
    from scipy.special import stdtrit

    a, b = one.squares[horizon], rival.squares[horizon]
    if a.size != b.size or not a.size:
        return None
    _, place, starts = np.unique(one.block[horizon], return_inverse=True, return_counts=True)
    blocks = starts.size
    if blocks < LEAST_BLOCKS:
        return None
    difference, scale = a - b, float(b.mean())
    mean = float(difference.mean())
    sums = np.bincount(place, difference - mean)
    error = float(np.sqrt(sums @ sums * blocks / (blocks - 1))) / difference.size
    ratio = np.log(np.maximum(np.bincount(place, a), 1e-30) / np.maximum(np.bincount(place, b), 1e-30))
    spread = float(ratio.std(ddof=1)) / float(np.sqrt(blocks))
    reach = float(stdtrit(blocks - 1, 1 - 0.025 / tries))
    return Change(mean / scale, error / scale, float(ratio.mean()), spread, reach)


@dataclass(frozen=True)
class _Verdict:
    """A trial, its rival, whether the trial replaces the rival, and the reason in words."""

    trial: _Trial
    rival: _Trial
    passed: bool
    words: str


def _verdict(trial: _Trial, rival: _Trial, tries: int) -> _Verdict:
    """Whether a trial replaces its rival.

    A richer structure, or another one of the same size, must be better by the criterion, significantly better in one
    kind of prediction, and no worse in either. Where the evidence of the criterion is overwhelming, smaller errors over
    1 s are enough: the few blocks of a minute's flight do not show them surely. Nor need predictions be better where
    the evidence is very strong that the rival lacks a delay: it would be published as 0. A simpler structure must be
    better by the criterion and no worse in both. The delay that a structure without one neglects must be known to be
    small. A limit of the acceleration, where its evidence is overwhelming, may predict worse far ahead. Since several
    structures are tried, the significance level is 2.5 % for all of them together (Bonferroni).
    """
    near, far = (change_of(trial.held_out, rival.held_out, horizon, tries) for horizon in (NEAR, FAR))
    name, cheaper = rival.structure.name, trial.bic < rival.bic
    if not trial.separable:
        return _Verdict(trial, rival, False, SAME)
    if near is None or far is None:
        return _on_little(trial, rival)
    simpler = trial.structure.size < rival.structure.size
    gained, missed = rival.bic - trial.bic, trial.structure.delayed and not rival.structure.delayed
    likelier = (gained > OVERWHELMING and near.smaller) or (gained > VERY_STRONG and missed)
    better = near.better or far.better or likelier
    limit = trial.structure.limited and gained > OVERWHELMING  # far ahead an offset counts, which no limit cures
    kept = near.no_worse and (far.no_worse or limit)
    numbers = f"criterion {-gained:+.0f}, squared errors at 1 s {near.words}; at 5 s {far.words}"
    if cheaper and kept and (simpler or better) and trial.neglected <= NEGLIGIBLE_DELAY:
        return _Verdict(trial, rival, True, f"preferred to {name}: {numbers}")
    if trial.neglected > NEGLIGIBLE_DELAY:
        why = f"the delay may be as long as {trial.neglected:.2f} s"
    elif simpler and not cheaper:
        why = "the likelihood decreases by more than the penalty of a parameter"
    elif not cheaper:
        why = "the likelihood gain does not justify its parameters"
    elif not kept:
        why = "it predicts worse"
    else:
        why = "its predictions are not better beyond their uncertainty"
    return _Verdict(trial, rival, False, f"rejected: {why} ({numbers})")


def _candidate(verdict: _Verdict, best: _Trial) -> Candidate:
    trial, rival = verdict.trial, verdict.rival
    changes = [change_of(trial.held_out, rival.held_out, horizon) for horizon in (NEAR, FAR)]
    first = trial is rival
    velocity, position = (None if first or change is None else (change.total, change.total_error) for change in changes)
    return Candidate(
        structure=trial.structure.name,
        parameters=2 + trial.structure.size,
        log_likelihood=trial.log_likelihood,
        bic=trial.bic,
        velocity=trial.held_out.rmse(NEAR),
        position=trial.held_out.rmse(FAR),
        rival="" if first else rival.structure.name,
        velocity_change=velocity,
        position_change=position,
        verdict=verdict.words,
        chosen=trial is best,
    )


def unidentifiable_candidate(structure: str) -> Candidate:
    """The row of a requested structure whose further parameters are not identifiable."""
    size = 2 + STRUCTURES[structure].size
    return Candidate(structure, size, 0.0, 0.0, None, None, FIRST_ORDER_DELAY.name, None, None, SAME, False)


def _on_little(trial: _Trial, rival: _Trial) -> _Verdict:
    """The verdict where predictions are too few for a test: very strong evidence from the criterion, smaller errors."""
    error, other = trial.held_out.rmse(NEAR), rival.held_out.rmse(NEAR)
    if error is None or other is None:
        return _Verdict(trial, rival, False, "not judged: too few data are held out to compare predictions")
    numbers = (
        f"criterion {trial.bic - rival.bic:+.0f}, errors at 1 s {error / other:.2f} times as large, too few to test"
    )
    passed = trial.structure.size >= rival.structure.size and trial.bic < rival.bic - VERY_STRONG and error < other
    if passed:
        return _Verdict(trial, rival, True, f"preferred to {rival.structure.name} on few data: {numbers}")
    return _Verdict(trial, rival, False, f"rejected: few data are held out, and the evidence is not strong ({numbers})")
