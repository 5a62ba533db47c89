"""What the data can and cannot tell: findings from a fit and its flights."""

from collections.abc import Iterator, Sequence

import numpy as np

from rotorfit.finding import Finding
from rotorfit.fit import Fit
from rotorfit.flight import Flight
from rotorfit.frames import AXES, Array
from rotorfit.model import Axis
from rotorfit.record import DELAY_RANGE

WEAK_GAIN = 0.2
"""Standard error of the input gain, as a share of it, beyond which the excitation is called weak."""

SHORT_TIME = 20.0
"""Flight time of an axis below which it is called short [s]."""

SATURATED_SHARE = 0.1
"""Share of the commanded time at the largest command beyond which it is called saturated."""

STALE_SHARE = 0.05
"""Share of repeated poses that is worth a word."""

LIKELIHOOD_DOUBT = 2.0
"""Log-likelihood by which a disbelieved optimum must stand above the chosen one to be a finding."""


def findings_of_fit(fit: Fit) -> tuple[Finding, ...]:
    """Everything that a user should know about a fit, the gravest first.

    Args:
        fit: The fit with its flights.
    """
    found: list[Finding] = []
    for k, name in enumerate(AXES):
        axis = fit.model.axes[name]
        flights = [f for f, s in zip(fit.flights, fit.model.flights, strict=True) if name in s.axes]
        found += _status_findings(name, axis, bool(flights))
        if axis.predictor:
            found += _coefficient_findings(name, axis)
            found += _mode_findings(name, axis)
            found += _excitation_findings(name, k, axis, flights)
        found += _paper_findings(fit, k)
    found += _flight_findings(fit.flights)
    rank = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(found, key=lambda finding: rank[finding.severity]))


def _status_findings(name: str, axis: Axis, moved: bool) -> Iterator[Finding]:
    status = axis.status["input"]
    if status == "not_excited" and moved and axis.noise:
        yield Finding(
            "not_excited",
            "warning",
            f"the {name} command explains nothing: with it the motion is predicted no better than without it",
            f"no coefficient of {name} is a number",
            f"fly {name} with the paper's two sines or larger steps, not only with a position controller's corrections",
            name,
        )
    elif status == "too_short":
        yield Finding(
            "too_short",
            "warning",
            f"the flights that move {name} hold too little commanded time to estimate from",
            f"no coefficient of {name} is a number",
            "fly longer than 20 s with commands throughout",
            name,
        )
    elif status == "diverged":
        yield Finding(
            "diverged",
            "error",
            f"the likelihood of {name} has no clear maximum: the climb did not end",
            f"no coefficient of {name} is a number",
            "check the card's columns and signs for this axis, or give a span without take-off and landing",
            name,
        )


def _coefficient_findings(name: str, axis: Axis) -> Iterator[Finding]:
    point = axis.predictor
    assert point is not None
    if point.input < 0:
        yield Finding(
            "sign_flipped",
            "warning",
            f"the input gain of {name} is {point.input:.3g}: a positive command moves {name} backwards",
            "the model is right for these logs, but the card's sign is not what other flights and controllers expect",
            f"give the {name} channel of [command] in the card scale = -1",
            name,
        )
    if point.damping < 0:
        _, high = axis.ci95["damping"]
        yield _unstable(name, point.input, point.damping, high is not None and high < 0)
    if "delay" in axis.status and axis.profile:
        yield from _delay_findings(name, axis, point.delay)
    if axis.status["damping"] == "not_identifiable":
        low, high = axis.ci95["damping"]
        gain, lag = axis.combinations["steady_gain"], axis.combinations["total_lag"]
        yield Finding(
            "damping_not_identifiable",
            "info",
            f"the damping of {name} lies anywhere between {_end(low)} and {_end(high)} 1/s (95 %)",
            f"what is known of {name} is the steady gain {gain.value:.3g} and the total lag {lag.value:.3g} s"
            if None not in (*gain.ci95, *lag.ci95)
            else f"the input gain of {name} is known, how fast its speed fades is not",
            "fly faster changes of the command" if high is None or high > 3.0 else "fly longer, at constant command",
            name,
        )
    if axis.status["input"] == "not_identifiable":
        gain = axis.combinations["steady_gain"]
        yield Finding(
            "input_not_identifiable",
            "info",
            f"{name} answers faster than the data resolve: gain and damping grow together without bound",
            f"the steady gain of {name}, {gain.value:.3g}, is known; its parts are not",
            "use the steady gain with the total lag, or record poses and commands at a higher rate",
            name,
        )


def _delay_findings(name: str, axis: Axis, delay: float) -> Iterator[Finding]:
    low, high = axis.ci95["delay"]
    if min(abs(delay - end) for end in DELAY_RANGE) < 1e-6:
        yield Finding(
            "delay_at_bound",
            "error",
            f"the delay of {name} ends at the bound of its range, {delay:.2f} s",
            f"no coefficient of {name} can be trusted",
            "check the clocks of commands and poses; stamps of different computers are the usual cause",
            name,
        )
    elif high is not None and high < 0:
        yield Finding(
            "delay_negative",
            "warning",
            f"{name} seems to answer {-1e3 * delay:.0f} ms before its command (95 %: {_end(low)} to {_end(high)} s)",
            "the clocks of commands and poses disagree by at least as much; the delay is not the vehicle's",
            "use one clock for both streams, or the stamps at which both were received",
            name,
        )
    elif axis.status["delay"] == "not_identifiable":
        yield Finding(
            "delay_not_identifiable",
            "info",
            f"the delay of {name} lies anywhere between {_end(low)} and {_end(high)} s (95 %)",
            "delay and damping trade against each other in these data",
            "fly commands with steps or higher frequencies: slow sines hardly show a delay",
            name,
        )


def _mode_findings(name: str, axis: Axis) -> Iterator[Finding]:
    chosen = next((mode for mode in axis.modes if mode.chosen), None)
    rivals = [mode for mode in axis.modes if not mode.chosen]
    if chosen is None or not rivals:
        return
    rival = max(rivals, key=lambda mode: mode.log_likelihood)
    above = rival.log_likelihood - chosen.log_likelihood
    if above > LIKELIHOOD_DOUBT and rival.prediction and chosen.prediction and rival.prediction > chosen.prediction:
        yield Finding(
            "likelihood_and_prediction_disagree",
            "warning",
            f"the likelihood of {name} is {above:.0f} log units higher at a delay of {rival.delay:.3f} s, but predicts "
            f"{rival.prediction / chosen.prediction:.1f} times worse over 1 s than the delay of {chosen.delay:.3f} s",
            "the optimum that predicts was taken; the other reads the commands of a feedback loop as a measurement",
            f"excite {name} from outside the feedback loop, with a reference that moves or an added signal",
            name,
        )


def _excitation_findings(name: str, k: int, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    error = axis.stderr["input"]
    if axis.input and error and error > WEAK_GAIN * abs(axis.input):
        yield Finding(
            "weak_excitation",
            "warning",
            f"the input gain of {name} is known to {100 * error / abs(axis.input):.0f} % only",
            f"all coefficients of {name} are wide",
            "fly larger or longer commands on this axis",
            name,
        )
    time = sum(flight.duration for flight in flights)
    if time < SHORT_TIME:
        yield Finding(
            "short_data",
            "warning",
            f"{name} is moved for {time:.0f} s",
            "intervals from so little data are optimistic where the disturbance is slow",
            f"fly {name} for a minute or more",
            name,
        )
    share = max((_saturated(flight.command[:, k]) for flight in flights), default=0.0)
    if share > SATURATED_SHARE:
        yield Finding(
            "saturated_commands",
            "info",
            f"the {name} command stands at its largest value in {100 * share:.0f} % of the samples",
            "harmless if the vehicle received what was logged; else the gain comes out too small",
            "log the command as sent, after its limits",
            name,
        )


def _saturated(command: Array) -> float:
    """Share of samples at the largest magnitude, where that is held rather than touched."""
    top = np.abs(command) >= np.abs(command).max() * (1 - 1e-9)
    levels = np.unique(command).size
    return float(top.mean()) if levels > 5 else 0.0


def _paper_findings(fit: Fit, k: int) -> Iterator[Finding]:
    name, damping = AXES[k], fit.model.paper[2 * k + 1]
    axis, gain = fit.model.axes[name], fit.model.paper[2 * k]
    if fit.model.method != "ml" or damping is None or gain is None or damping >= 0 or not axis.predictor:
        return
    yield Finding(
        "paper_damping_negative",
        "info",
        f"the paper's regression gives {name} a damping of {damping:.2g} 1/s on the same data",
        f"it leaves out the delay of {axis.predictor.delay + axis.predictor.extra.get('lag', 0.0):.2f} s, and the "
        "damping pays; the likelihood keeps it",
        "use the model as it is; the paper's coefficients are there for comparison",
        name,
    )


def _unstable(name: str, gain: float, damping: float, certain: bool) -> Finding:
    return Finding(
        "damping_unstable",
        "error" if certain else "warning",
        f"the regression gives {name} a damping of {damping:.2g} 1/s and a gain of {gain:.3g}: speed grows by itself",
        "a multirotor does not do that: the delay between command and motion is left out and the damping pays for it, "
        "feedback and noisy derivatives add to it",
        "use --method ml, which estimates the delay and keeps the damping positive",
        name,
    )


def _flight_findings(flights: Sequence[Flight]) -> Iterator[Finding]:
    for flight in flights:
        stale = sum(note.count for note in flight.notes if note.code == "stale_poses")
        outside = sum(note.count for note in flight.notes if note.code == "poses_outside")
        share = stale / max(stale + outside + flight.pose_time.size, 1)
        if share > STALE_SHARE:
            yield Finding(
                "stale_poses",
                "info",
                f"{flight.path}: {stale} poses ({100 * share:.0f} %) repeat the one before under a fresh stamp",
                "they were dropped; kept, they would move gain and delay",
                "let the motion capture bridge publish new frames only",
            )


def _end(value: float | None) -> str:
    return "an end that the data do not give" if value is None else f"{value:.3g}"
