"""Tests of the law of an estimate: do all parts of the flights give the same coefficients, whatever was flown?

An estimate is a weighted sum of innovations, so each part of the data, however it is divided, gives an estimate of its
own: part m gives theta + V sum_m w e / sum_m w^2, with variance V / share_m, where share_m is its share of the
information. If the law is right, the parts differ by chance; if not, the coefficient depends on what was flown, and
parts selected by what was flown show it:

- time: stretches of the flights; what changes in an hour often changes in a minute;
- quarter: quarters of long flights; what changes slowly, or once, is lost in many short stretches;
- size: small or large commands in the last second; limits of acceleration, braking, dead zones;
- speed: slow or fast changes of the command; dynamics that the law lacks.

Limits of the acceleration, a drag of the square and a slow part have a test of their own (`omitted_terms`).

Since parts are selected by what preceded an innovation, they are independent in a feedback loop, too. Parts of several
flights are compared within each flight only: by how much flights differ is another question (`random_effects`).

The part of the response that the law leaves out remains in the innovations, which then correlate with the commands of
the previous second. The ratio of that correlation's power to the power expected by chance is the factor by which the
variance of the estimates must grow: lack of fit in place of pure error.

Source: W. G. Cochran, Biometrics 10 (1954), pp. 101-129; R. DerSimonian, N. Laird, Controlled Clinical Trials 7 (1986),
pp. 177-188; N. R. Draper, H. Smith, Applied Regression Analysis, 3rd ed. (1998), section 2.2 (lack of fit).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.frames import POSE_UNITS, Array, Indices, Mask
from rotorfit.core.model import Evidence
from rotorfit.estimation.judgement.omitted_terms import SLOW, OmittedTerm
from rotorfit.estimation.judgement.other_laws import BetweenLaws
from rotorfit.estimation.judgement.random_effects import excess_spread
from rotorfit.estimation.judgement.residual_variance import Ratio, Weighted, orthonormal
from rotorfit.estimation.judgement.spread_prior import spread_scale
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.regression.paper import newey_west

STRETCH = 12.0
"""Length of the stretches of time [s]: longer than the memory of wind, short enough that a minute has five."""

STRETCHES = 25
"""Most stretches of a flight: longer flights have longer ones, none of which falls below `LEAST_SHARE`."""

QUARTERS = 4
"""Number of parts of a flight that is twice as many stretches long, for what changes slowly."""

MEMORY = 1.0
"""How far back commands are considered [s]."""

LEAST_SHARE = 0.02
"""Share of the information of its flights below which a part is left out."""

EVERY = 0.1
"""Spacing of the past commands that are tested together [s]."""

DISTINCT = 1e-3
"""Share of the largest variance below which a combination of past commands counts as dependent on the others."""


@dataclass(frozen=True)
class Homogeneity:
    """Agreement of estimates of one quantity from several parts of the data.

    Attributes:
        statistic: Cochran's Q.
        freedom: Number of independent differences between parts of the same flight.
        p_value: Probability of a larger Q if the parts do not differ.
        sd: Standard deviation between the parts beyond chance and prior, in standard errors of the estimate.
    """

    statistic: float
    freedom: int
    p_value: float
    sd: float


def cuts(records: Sequence[Record], weighted: Sequence[Weighted], k: int) -> Mapping[str, list[Indices]]:
    """Parts of each flight, one label per block, shape (B,), by the name of the criterion."""
    memory = [_before(rec, one.time, k) for rec, one in zip(records, weighted, strict=True)]
    sizes = np.concatenate([size for size, _ in memory])
    speeds = np.concatenate([speed for _, speed in memory])
    counts = [min(max(1, round(float(np.ptp(one.time)) / STRETCH)), STRETCHES) for one in weighted]
    fewer = [QUARTERS if count >= 2 * QUARTERS else count for count in counts]
    return {
        "time": _stretches(weighted, counts),
        **({"quarter": _stretches(weighted, fewer)} if fewer != counts else {}),
        "size": [_thirds(size, sizes) for size, _ in memory],
        "speed": [_thirds(speed, speeds) for _, speed in memory],
    }


def _stretches(weighted: Sequence[Weighted], counts: Sequence[int]) -> list[Indices]:
    """The stretch of each block of each flight, which has so many of equal length, counted over all flights."""
    out, offset = [], 0
    for one, count in zip(weighted, counts, strict=True):
        elapsed = one.time - one.time[0]
        out.append(offset + np.minimum((count * elapsed / (elapsed[-1] + 1e-9)).astype(int), count - 1))
        offset += count
    return out


def _before(rec: Record, time: Array, k: int) -> tuple[Array, Array]:
    """RMS, less the flight's median, and standard deviation of the command in the second before each block, (B,)."""
    grid = np.arange(0.0, MEMORY, 0.1)[:, None]
    place = np.searchsorted(rec.command_time, time - grid, side="right") - 1
    command = rec.command[np.maximum(place, 0), k]
    command = command - np.median(rec.command[:, k])
    return np.sqrt(np.mean(command**2, axis=0)), np.std(command, axis=0)


def _thirds(values: Array, everywhere: Array) -> Indices:
    return np.searchsorted(np.quantile(everywhere, [1 / 3, 2 / 3]), values)


@dataclass(frozen=True)
class Parts:
    """What M parts of the data say of one quantity, in standard errors of the published estimate.

    Part m of flight f puts the quantity at pull / share, less the published estimate, with variance 1 / share.

    Attributes:
        pull: Shape (F, M).
        share: Of the information, shape (F, M).
        told: Whether a part has enough information, shape (M,).
    """

    pull: Array
    share: Array
    told: Mask

    def within(self, parts: Mask) -> tuple[Array, Array]:
        """Sums of the pulls over the flights, less each flight's mean, (M,), and their covariance (M, M).

        Effects delta of some parts, common to all flights, add the covariance times delta to the sums.

        Source: S. R. Searle, Linear Models (1971), section 7.2 (the reduced normal equations of a two-way layout).
        """
        pull, share = np.where(parts, self.pull, 0.0), np.where(parts, self.share, 0.0)
        flight = np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
        mean = share / flight
        return (pull - mean * pull.sum(axis=1, keepdims=True)).sum(axis=0), np.diag(share.sum(axis=0)) - mean.T @ share


def estimates_of_parts(weighted: Sequence[Weighted], labels: Sequence[Indices], q: int, wider: float) -> Parts:
    """Estimates of quantity q from the parts of a cut.

    Args:
        weighted: Innovations and weights of each flight.
        labels: Part of each block, one array of shape (B,) per flight.
        q: Index of the quantity.
        wider: Factor on its standard error for innovations that are not white.
    """
    count = 1 + max(int(part.max()) for part in labels)
    pull, power = np.zeros((2, len(weighted), count))
    for f, (one, part) in enumerate(zip(weighted, labels, strict=True)):
        pull[f] = np.bincount(part, np.sum(one.weight[:, :, q] * one.innovation, axis=1), count)
        power[f] = np.bincount(part, np.sum(one.weight[:, :, q] ** 2, axis=1), count)
    total = max(power.sum(), 1e-300)
    flight = np.where(power > 0, power.sum(axis=1, keepdims=True), 0.0).sum(axis=0)
    return Parts(pull / (np.sqrt(total) * wider), power / total, power.sum(axis=0) > LEAST_SHARE * flight)


def agreement(parts: Mapping[str, Parts], scale: Callable[[str], float]) -> Mapping[str, Homogeneity]:
    """Agreement of the parts of one cut about each quantity that two parts of a flight tell.

    Where the parts certainly differ about one quantity, each other one that changes with it from part to part has at
    least that share of its spread: alone it may be known too little from each part to show one. So a steady gain is as
    wrong as the input of a vehicle whose input alone has changed.

    Args:
        parts: Estimates of each quantity.
        scale: Scale of the prior on the spread of a quantity, in its standard errors.
    """
    known = {name: one for name, one in parts.items() if np.count_nonzero(one.told) > 1}
    apart = {name: _differences(*one.within(one.told)) for name, one in known.items()}
    alone = {name: homogeneity_of(*one, scale(name)) for name, one in apart.items() if one[0].size}
    leader = min(alone, key=lambda name: alone[name].p_value, default=None)
    if leader is None or alone[leader].p_value >= CERTAIN:
        return alone
    led = {name: _slope(known[leader], known[name]) * alone[leader].sd for name in alone}
    return {name: replace(one, sd=max(one.sd, led[name])) for name, one in alone.items()}


def _differences(pull: Array, covariance: Array) -> tuple[Array, Array]:
    """Independent differences between parts, and their standard errors, both (N,): their expectation is 0."""
    size, direction = np.linalg.eigh(covariance)
    some = size > DISTINCT_PARTS * size[-1]
    return (direction.T @ pull)[some] / size[some], size[some] ** -0.5


def _slope(leader: Parts, parts: Parts) -> float:
    """Change of a quantity for a unit of another one's, from part to part, less what chance gives it; at least 0."""
    both = leader.told & parts.told
    pull, covariance = leader.within(both)
    along = np.linalg.pinv(covariance, DISTINCT_PARTS, hermitian=True) @ pull
    pull, covariance = parts.within(both)
    power = float(along @ covariance @ along)
    if power <= 0:  # both are known of one part at most
        return 0.0
    return float(np.sqrt(max((float(along @ pull) / power) ** 2 - 1 / power, 0.0)))


def homogeneity_of(apart: Array, error: Array, scale: float) -> Homogeneity:
    """Agreement of several estimates of one quantity, in standard errors of the published estimate.

    Args:
        apart: Independent differences between them, which vary by the spread as the estimates do, shape (N,).
        error: Their standard errors, shape (N,).
        scale: Scale of the prior on the spread.
    """
    from scipy.special import chdtrc

    statistic = float(np.sum((apart / error) ** 2))
    return Homogeneity(statistic, apart.size, float(chdtrc(apart.size, statistic)), excess_spread(apart, error, scale))


@dataclass(frozen=True)
class LackOfFit:
    """Dependence of innovations on earlier commands.

    Attributes:
        statistic: Test statistic, chi-squared with `freedom` degrees of freedom if there is no dependence.
        freedom: Number of independent combinations of past commands.
        p_value: Probability of a larger statistic without dependence.
        factor: Factor on the variance of the estimates, at least 1.
    """

    statistic: float
    freedom: int
    p_value: float
    factor: float


def lack_of_fit(records: Sequence[Record], weighted: Sequence[Weighted], k: int) -> LackOfFit | None:
    """Tests whether the innovations of axis k depend on its commands of the previous second, all flights together.

    The directions that the fit took from the innovations are projected out of the commands, too. None where no command
    changes.

    Source: L. Ljung, System Identification, 2nd ed. (1999), section 16.6; W. K. Newey, K. D. West, Econometrica 55
    (1987), pp. 703-708, and Rev. Econ. Stud. 61 (1994), pp. 631-653 (lags of the kernel).
    """
    from scipy.special import chdtrc

    past = [_past(rec, one, k) for rec, one in zip(records, weighted, strict=True)]
    size, directions = np.linalg.eigh(sum(u.T @ u for u in past))
    if size[-1] <= 0:
        return None
    distinct = directions[:, size > DISTINCT * size[-1]]
    total, spread = np.zeros(distinct.shape[1]), np.zeros((distinct.shape[1],) * 2)
    for u, one in zip(past, weighted, strict=True):
        scores = (u @ distinct) * one.innovation[:, k][:, None]
        lag = (int(4 * (len(scores) / 100) ** (2 / 9)) + 1) * float(np.median(one.time[2:] - one.time[:-2])) / 2
        total += scores.sum(axis=0)
        spread += newey_west(one.time, scores - scores.mean(axis=0), lag)
    statistic = float(total @ np.linalg.solve(spread, total))
    freedom = total.size
    ratio = Ratio(statistic / freedom, 2 / freedom)
    return LackOfFit(statistic, freedom, float(chdtrc(freedom, statistic)), ratio.beyond_chance)


def _past(rec: Record, one: Weighted, k: int) -> Array:
    """Commands of the second before each block, the fitted directions projected out, shape (B, L)."""
    grid = np.arange(EVERY, MEMORY + 0.5 * EVERY, EVERY)
    place = np.searchsorted(rec.command_time, one.time[:, None] - grid, side="right") - 1
    u = rec.command[np.maximum(place, 0), k]
    basis = orthonormal(np.column_stack([np.ones(len(u)), one.span[:, k]]))
    return np.asarray(u - basis @ (basis.T @ u))


DISTINCT_PARTS = 1e-9
"""Share of the largest variance below which a difference between parts is none."""

REJECTED = 0.001
"""p-value below which a test is reported as evidence against the law: a fit has four axes with up to seven tests."""

CERTAIN = 1e-5
"""p-value below which a test may refute a number."""

REFUTED = 3.0
"""Factor on the standard error beyond which widening cannot express the error: the law is not that of the vehicle."""


@dataclass(frozen=True)
class Doubt:
    """Result of the tests of the law of an axis.

    Attributes:
        factor: Factor on the standard error, by coefficient or combination, at least 1.
        evidence: Tests that contradict the law, the strongest first.
        refuted: Coefficients and combinations whose error no widening can express.
    """

    factor: Mapping[str, float]
    evidence: tuple[Evidence, ...]
    refuted: tuple[str, ...]


def doubt(
    records: Sequence[Record],
    weighted: Sequence[Weighted],
    k: int,
    errors: Mapping[str, float],
    wider: Mapping[str, float],
    method: Mapping[str, Homogeneity],
    closed: bool,
    omitted: OmittedTerm | None = None,
    between: BetweenLaws | None = None,
) -> Doubt:
    """All tests of the law of axis k.

    Args:
        records: Its flights.
        weighted: Their innovations and weights, in the order of `errors`.
        k: Index of the axis in the likelihood.
        errors: Standard errors by name, widened for innovations that are not white.
        wider: Factors by which they were widened, by name.
        method: Agreement with another method, by name.
        closed: Whether that method stands in for the likelihood, which a feedback loop biases: then its error is not
            multiplied by the lack of fit, most of which is the loop's.
        omitted: The likeliest term that the law leaves out.
        between: What other laws say.
    """
    names = list(errors)
    labels = cuts(records, weighted, k)
    parts = {
        cut: dict(
            agreement({n: estimates_of_parts(weighted, label, q, wider[n]) for q, n in enumerate(names)}, spread_scale)
        )
        for cut, label in labels.items()
    }
    if not closed:
        parts["method"] = dict(method)
    rest = lack_of_fit(records, weighted, k)
    unfit = rest.factor if rest else 1.0
    apart = {n: max((found[n].sd for found in parts.values() if n in found), default=0.0) for n in names}
    looped = {n: one.sd for n, one in method.items()} if closed else {}
    if closed:
        parts["method"] = dict(method)

    def widened(level: float) -> dict[str, float]:
        """Factors with an omitted term whose p-value is below a level."""
        taken = omitted.sd if omitted and omitted.p_value < level else {}
        law = {n: np.sqrt(unfit) * np.hypot(1.0, max(apart[n], taken.get(n, 0.0))) for n in names}
        return {n: float(max(factor, np.hypot(1.0, looped.get(n, 0.0)))) for n, factor in law.items()}

    evidence = [_between_parts(cut, found, errors) for cut, found in parts.items() if found]
    if omitted:
        evidence.append(_omitted(omitted, records[0].axes[k], errors))
    if between:
        evidence.append(_likelier(between))
    if rest:
        evidence.append(_following(rest, errors))
    told = sorted((one for one in evidence if one.p_value < REJECTED), key=lambda one: one.p_value)
    factor = widened(CERTAIN)
    told = [replace(one, refutes=_refutes(one, factor)) for one in told]
    certain = any(one.refutes for one in told)
    refuted = tuple(name for name in names if certain and factor[name] > REFUTED)
    return Doubt(widened(REJECTED), tuple(told), refuted)


def _refutes(one: Evidence, factor: Mapping[str, float]) -> bool:
    return (
        one.test not in ("order", "twice") and one.p_value < CERTAIN and any(factor[name] > REFUTED for name in one.sd)
    )


_CUTS = {
    "time": "stretches of time do not agree",
    "quarter": "quarters of long flights do not agree",
    "size": "small and large commands do not agree",
    "speed": "slow and fast commands do not agree",
    "method": "likelihood and instrumental variables do not agree",
}


def _between_parts(cut: str, found: Mapping[str, Homogeneity], errors: Mapping[str, float]) -> Evidence:
    """Evidence from the quantity with the lowest p-value, which is corrected for about three independent quantities."""
    worst = min(found, key=lambda name: found[name].p_value)
    one = found[worst]
    return Evidence(
        cut,
        f"{_CUTS[cut]}, most about the {worst.replace('_', ' ')}: chi-square {one.statistic:.0f} of {one.freedom}",
        min(1.0, INDEPENDENT * one.p_value),
        {name: part.sd * errors[name] for name, part in found.items() if part.sd > 0},
    )


INDEPENDENT = 3
"""About how many of the quantities of an axis are independent."""


def _omitted(term: OmittedTerm, axis: str, errors: Mapping[str, float]) -> Evidence:
    unit = POSE_UNITS[axis]
    cause = {
        "bound": f"an acceleration of no more than about {term.size:.2g} {unit}/s^2",
        "jerk": f"a jerk of no more than about {term.size:.2g} {unit}/s^3",
        "drag": f"a drag of the square of the speed, about {term.size:.2g} 1/{unit}",
        "slow": f"commands that last {SLOW:.0f} s and more being answered with about {abs(100 * term.size):.0f} % "
        f"{'more' if term.size > 0 else 'less'} acceleration than short ones",
    }[term.kind]
    return Evidence(
        term.kind,
        f"the residual is that of {cause}: chi-square {term.statistic:.0f} of 1",
        term.p_value,
        {name: sd * errors[name] for name, sd in term.sd.items() if sd > 0},
    )


def _likelier(between: BetweenLaws) -> Evidence:
    inner = "commands pass the lag twice, as an inner loop of the second order,"
    law = inner if between.twice else "the velocity is of the second order"
    return Evidence(
        "twice" if between.twice else "order",
        f"a law under which {law} is likelier by {between.gained:.0f} log units, with a total lag of "
        f"{between.total_lag:.3f} s",
        between.p_value,
        {name: by for name, by in between.apart.items() if by},
    )


def _following(rest: LackOfFit, errors: Mapping[str, float]) -> Evidence:
    return Evidence(
        "follows_command",
        f"the residual depends on the commands of the previous second: chi-square {rest.statistic:.0f} of "
        f"{rest.freedom}",
        rest.p_value,
        {name: float(np.sqrt(rest.factor - 1)) * error for name, error in errors.items()} if rest.factor > 1 else {},
    )
