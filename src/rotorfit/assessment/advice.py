"""What the data can and cannot show: findings from a fit and its flights.

Also why a vehicle seems to respond before its command: clocks that disagree, or commands that are logged too rarely.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorfit.assessment.constancy import EVENT, ONE, TWICE, changed_coefficients, command_events, widening
from rotorfit.assessment.flight_differences import disagreement_findings, turned_findings
from rotorfit.assessment.frequency.loop import seem_to_answer
from rotorfit.assessment.law_findings import (
    contradicted,
    law_findings,
    with_size,
)
from rotorfit.assessment.mismatch import findings_of_left_out
from rotorfit.assessment.plausibility import findings_of_settings
from rotorfit.assessment.prior_influence import prior_findings
from rotorfit.assessment.summary import is_told
from rotorfit.assessment.tilt_limit import findings_of_tilt
from rotorfit.core.finding import OTHER_STAMPS, WRONG_FRAME, Finding, by_gravity
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.frozen import frozen_axes, with_frozen
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import Axis, Combination, Weighed, first_order_beside, with_findings
from rotorfit.core.results import Fit
from rotorfit.diagnosis.command_checks import share_above
from rotorfit.diagnosis.doctor import SHORT_TIME
from rotorfit.diagnosis.frame_checks import OVER, remedy_in_the_pose
from rotorfit.diagnosis.position_loop import restored_axes
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import BLOCK_RATE
from rotorfit.estimation.likelihood.coefficients import statuses
from rotorfit.estimation.likelihood.outliers import outlier_findings
from rotorfit.estimation.methods import BEST, METHODS, label_of
from rotorfit.estimation.regression.instrumental_variables import COMMAND
from rotorfit.estimation.zero_command import findings_of_braking

ONE_CLOCK = (".ulg", ".bin")
"""Suffixes of autopilot logs: one clock stamps everything in them."""


def too_early(flights: Sequence[Flight], early: float) -> tuple[str, str]:
    """Effect and remedy of a negative delay, depending on the flights.

    A command is logged at its row's time. If it was sent between two rows, it acts before it is logged: by up to one
    period of the rows, and by half a period on average where commands change all the time.

    Args:
        flights: Those that serve the axis.
        early: By how much the response precedes its command [s].
    """
    period = max(float(np.median(np.diff(flight.command_time))) for flight in flights)
    seldom = (
        f"the commands are logged every {1e3 * period:.0f} ms, and one that was sent between two rows acts before it "
        f"is logged: delays come out up to {1e3 * period:.0f} ms too short, {5e2 * period:.0f} ms in the mean"
    )
    if not all(_one_clock(flight) for flight in flights):
        beside = f"; or {seldom}" if early <= period else ""
        return (
            f"the clocks of commands and poses disagree by at least as much{beside}; the delay is not the vehicle's",
            "use one clock for both streams, or the stamps at which both were received"
            + (", and log every command that is sent" if beside else ""),
        )
    logged = all(Path(flight.path).suffix.lower() in ONE_CLOCK for flight in flights)
    one = (
        "one clock stamps commands and poses, so it is not the clocks"
        if logged
        else "one clock stamps commands and poses, though perhaps a command when it is written, not when it is sent"
    )
    if early <= period:
        return (
            f"{one}; {seldom}; the delay is not the vehicle's",
            "log every command that is sent (PX4: raise the rate of the set-point's topic in the logger)",
        )
    seldom = f"commands that are logged every {1e3 * period:.0f} ms do not explain it"
    stamp = "" if logged else ", and that its stamp is when it was sent"
    return (
        f"{one}; {seldom}; the delay is not the vehicle's",
        f"check that the card's command is the command as sent, not a measured or filtered copy{stamp}",
    )


def _one_clock(flight: Flight) -> bool:
    """Whether commands and poses of a flight are certainly stamped by one clock."""
    card = flight.card
    same = card.command_time.source == card.pose_time.source
    return flight.clocks is None and (same or Path(flight.path).suffix.lower() in ONE_CLOCK)


WEAK_GAIN = 0.2
"""Relative standard error of the input gain above which the excitation is called weak."""

LONG_LAG = 0.35
"""Lag from which its state at the start of a flight matters: of a lag of 0.3 s no harm was found, of 0.4 s two of eight
intervals missed [s]."""

SMALL_START = 0.1
"""Share of the largest command below which a flight counts as begun in hover."""

IMPOSSIBLE_TRIM = 5.0
"""Trim that no wind and no misalignment gives: half of gravity [m/s^2; rad/s^2 for yaw]."""

NEEDED_SHARE = 0.05
"""Share of the command's power that must lie where delay and damping take effect; with less, noise makes them hard to
separate. The paper's sines have none above 0.25 Hz, steps of a second 10 to 20 % above 0.8 Hz."""

OVERTURNED = "axes_turned"
"""Finding of a flight that makes the signs of `OVER` meaningless."""

LEFT_TO_THE_FIT = ("short_data", "slow_commands")
"""Findings of single flights that the fit of all of them repeats or withdraws."""

ABOUT_EXCITATION = ("velocity_follows_command", "wind_dominates")
"""Findings of single flights that do not matter where all coefficients of the axis are well determined, nor where it is
not excited: the fit says that itself."""

LIKELIHOOD_DOUBT = 2.0
"""Difference in log-likelihood by which a rejected optimum must exceed the chosen one to be a finding."""

ABOUT_DELAY = ("delay_not_identifiable", "delay_negative")
"""Findings about the delay that are left out where the offset of two clocks includes it."""


def with_advice(fit: Fit, flights: Sequence[Flight], axes: Sequence[str]) -> Fit:
    """The fit with all its findings, and with the status that a frozen pose gives what it keeps from being known.

    Args:
        fit: The fit.
        flights: The flights with their findings, as they were before the fit left axes out that a flight merely holds.
        axes: The axes that were fitted.
    """
    before = [
        told
        for flight, fitted in zip(flights, fit.flights, strict=True)
        for told in flight.findings
        if told.axis is None
        or (told.axis in axes and told.axis not in set(flight.axes) - set(fitted.axes))
        or set(frozen_axes([told])) & set(axes)
    ]
    findings = by_gravity((*findings_of_fit(fit, before), *findings_of_settings(fit.model)))
    return replace(fit, model=with_frozen(with_findings(fit.model, findings), axes))


def findings_of_fit(fit: Fit, before: Iterable[Finding] = ()) -> tuple[Finding, ...]:
    """Everything that a user should know about a fit, most severe first.

    Args:
        fit: The fit with its flights.
        before: Findings of the single flights; those that the fit supersedes are left out.
    """
    told = [finding for finding in before if not _settled(finding, fit)]
    found = list(told)
    framed = {finding.code for finding in found}.isdisjoint(WRONG_FRAME)
    wrong = () if framed else ("x", "y")  # what follows from a wrong frame would only bury it
    misread = wrong if any(one.code in WRONG_FRAME and one.severity == "error" for one in found) else ()
    stamped = {finding.code for finding in told}.isdisjoint(OTHER_STAMPS)
    overturned = any(finding.code == OVERTURNED for finding in found)
    clocked = any(flight.clocks and flight.clocks.includes_delay for flight in fit.flights)
    tilted = [one for one in findings_of_tilt(fit) if one.axis not in wrong]
    limited = {one.axis: one.remedy for one in tilted if one.severity == "warning"}
    for k, name in enumerate(AXES):
        axis = fit.model.axes[name]
        flights = [f for f, s in zip(fit.flights, fit.model.flights, strict=True) if name in s.axes]
        if not (name in misread and axis.status["input"] == "not_excited"):
            found += _status_findings(name, axis, flights, fit.remarks.get(name, ""))
        found += _event_findings(name, axis, flights)
        changed = list(changed_coefficients(fit, name)) if name not in wrong else []
        if axis.predictor and name not in wrong:
            found += () if overturned and name in OVER else _sign_findings(fit, name, axis)
            known = _coefficient_findings(name, axis, flights)
            found += (one for one in known if not (clocked and one.code in ABOUT_DELAY))  # the clocks say why
            found += _mode_findings(name, axis)
            found += _trim_findings(name, axis, flights)
            found += _start_findings(name, axis, flights)
            found += _excitation_findings(name, axis, flights)
            cause = limited.get(name) or (with_size(axis, changed[0].remedy) if changed else "")
            laws = law_findings(name, axis, stamped)
            # no other law explains a vehicle at its limit, or one that changed
            found += (replace(one, remedy=cause) if cause else one for one in laws)
        elif contradicted(axis):
            found += law_findings(name, axis, stamped)
        if axis.predictor and name in fit.estimates and name not in wrong:
            found += _slow_findings(name, k, axis, flights)
            found += _feedback_findings(name, fit.estimates[name])
            found += changed
            if name in fit.braking:
                whole = sum(flight.duration for flight in fit.flights)
                found += findings_of_braking(name, *fit.braking[name], whole)
        found += _paper_findings(fit, k)
        found += _instrument_findings(fit, name)
    found += tilted
    found += _bias_findings(fit.model.method)
    found += prior_findings(fit)
    found += outlier_findings(fit.flights, fit.outliers)
    found += disagreement_findings(fit)
    found += turned_findings(fit)
    for flight in fit.flights:
        found += findings_of_left_out(fit.model, flight) if flight.held else ()
    still = frozen_axes(told)
    return by_gravity(one for one in found if one in told or one.axis not in still)  # its remedies would be wrong


def _settled(finding: Finding, fit: Fit) -> bool:
    """Whether the fit supersedes this finding of a single flight."""
    if finding.code == "sign_flipped":
        return finding.axis is not None and fit.model.axes[finding.axis].predictor is not None
    if finding.code not in ABOUT_EXCITATION or finding.axis is None:
        return finding.code in LEFT_TO_THE_FIT
    axis = fit.model.axes[finding.axis]
    if axis.status["input"] == "not_excited":
        return bool(axis.noise)
    return all(status == "ok" for status in axis.status.values()) and not _weak(axis)


def _weak(axis: Axis) -> bool:
    error = axis.stderr.get("input")
    return bool(axis.input and error and error > WEAK_GAIN * abs(axis.input))


def _status_findings(name: str, axis: Axis, flights: Sequence[Flight], remark: str) -> Iterator[Finding]:
    status = axis.status["input"]
    held = status == "not_excited" and bool(restored_axes(flights, [name]))
    if held or (status == "not_excited" and flights and axis.noise):
        yield Finding(
            "not_excited",
            "warning",
            f"the {name} command is only a response to the motion, as from a position controller"
            if held
            else f"the {name} command explains nothing: with it the motion is predicted no better than without it",
            f"no coefficient of {name} is a number",
            f"fly {name} with the paper's two sines or larger steps, not only with a position controller's corrections",
            name,
        )
    elif status == "not_identifiable" and not axis.predictor and (beside := first_order_beside(axis)):
        yield Finding(
            "input_not_identifiable",
            "warning",
            f"the {name} command explains the motion, but the interval of the input under {axis.structure} holds 0; "
            f"with a delay alone the input is {beside.input:.3g}",
            f"{axis.structure} has no coefficients of {name}; card and excitation are not to blame for it",
            f"fit without --structure, or fly {name} with steps or a multisine, as `rotorfit plan` designs them",
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
            f"the estimate of {name} does not converge: {remark}"
            if remark
            else f"the likelihood of {name} has no clear maximum: the search did not converge",
            f"no coefficient of {name} is a number",
            "check the card's columns and signs for this axis, or give a span without take-off and landing",
            name,
        )


def _event_findings(name: str, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    """Finding that the commands change in only one event, or in few."""
    events = command_events(flights, name)
    factor = widening(events)
    if not axis.predictor or not flights or factor < TWICE:
        return
    once = events < ONE
    yield Finding(
        "few_command_events",
        "warning",
        f"the {name} command changes in only one event of {EVENT:g} s"
        if once
        else f"the {name} command changes in few events: they count as {events:.1f} equal ones of {EVENT:g} s",
        f"intervals of {name} hold only if the model is right; if what it leaves out differs from event to event, "
        + ("their width is unknown" if once else f"they are {factor:.1f} times as wide"),
        f"command {name} again and again: ten steps or more, or the paper's two sines",
        name,
    )


def _sign_findings(fit: Fit, name: str, axis: Axis) -> Iterator[Finding]:
    point = contradicted(axis) or axis.predictor
    assert point is not None
    if point.input >= 0:
        return
    channel = fit.model.card.command.get(name)
    scale = channel.scale if channel else 1.0  # a world command of one axis moves along both
    points = {axis: contradicted(one) or one.predictor for axis, one in fit.model.axes.items()}
    backwards = {axis: point.input < 0 for axis, point in points.items() if point}
    turning = max((float(np.std(flight.yaw)) for flight in fit.flights), default=0.0)
    pose = remedy_in_the_pose(name, backwards, turning, fit.model.card.frame)
    yield Finding(
        "sign_flipped",
        "warning",
        f"the input gain of {name} is {point.input:.3g}: a positive command moves {name} backwards",
        f"the model is right for these logs, but input gain and trim of {name} are not in the sign that other flights "
        "and controllers expect",
        f"give {name} in [command] of the card scale = {-scale:g} (now {scale:g}){pose}",
        name,
    )


def _coefficient_findings(name: str, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    point = axis.predictor
    assert point is not None
    if point.damping < 0:
        _, high = axis.ci95["damping"]
        yield _unstable(name, point.input, point.damping, high is not None and high < 0)
    if "delay" in axis.status and axis.profile:
        yield from _delay_findings(name, axis, point.delay, flights)
    undecided = _undecided(axis)
    if axis.status["damping"] == "not_identifiable":
        (low, high), late = axis.ci95["damping"], None in axis.ci95["delay"] and not _clocked(axis)
        faster = "fly faster changes of the command"
        yield Finding(
            "damping_not_identifiable",
            "info",
            f"the 95 % interval of the damping of {name} is {_end(low)} to {_end(high)} 1/s"
            + (", which does not hold where that of the delay is open" if late and None not in (low, high) else "")
            + _between_laws(axis, undecided),
            _known_beside(name, axis),
            _under(undecided, "damping", " 1/s")
            or (faster if late or high is None or high > 3.0 else "fly longer, at constant command"),
            name,
        )
    if axis.status["input"] == "not_identifiable" and axis.status["delay"] != "ok" and not _clocked(axis):
        yield Finding(
            "input_not_identifiable",
            "info",
            f"the delay of {name} is not identifiable: its commands respond to its motion, or it is at a bound",
            f"no coefficient of {name} is published: such a feedback loop shows only a slow response to old commands",
            f"excite {name} from outside the feedback loop, with a reference that moves or an added signal",
            name,
        )
    elif axis.status["input"] == "not_identifiable":
        gain, (low, high) = _told(axis, "steady_gain"), axis.ci95["input"]
        wide = None not in (low, high) and statuses(axis.ci95)["input"] != "ok"
        use = "use the steady gain with the total lag, or " * bool(gain and _told(axis, "total_lag"))
        yield Finding(
            "input_not_identifiable",
            "info",
            f"the 95 % interval of the input gain of {name} is {_end(low)} to {_end(high)}"
            + _between_laws(axis, undecided)
            if wide
            else f"{name} responds faster than the data resolve: gain and damping grow together without bound",
            f"the steady gain of {name}, {gain.value:.3g}, is known; its parts are not"
            if gain
            else f"neither the input gain of {name} nor its damping is known",
            _under(undecided, "input")
            or use + ("fly faster changes of the command" if wide else "record poses and commands at a higher rate"),
            name,
        )


def _clocked(axis: Axis) -> bool:
    """Whether the delay of an axis is open because it cannot be told from the offset of two clocks."""
    return "offset_plus_delay" in axis.combinations


def _told(axis: Axis, name: str) -> Combination | None:
    """A combination of the axis that the summary tells, too; else None."""
    part = axis.combinations.get(name)
    return part if part and is_told(name, part) else None


def _known_beside(name: str, axis: Axis) -> str:
    """What is known of an axis whose damping is not, as a clause."""
    gain, lag = (_told(axis, part) for part in ("steady_gain", "total_lag"))
    if gain and lag:
        return f"what is known of {name} is the steady gain {gain.value:.3g} and the total lag {lag.value:.3g} s"
    if axis.status["input"] == "ok":
        return f"the input gain of {name} is known, its damping is not"
    if gain:
        return f"what is known of {name} is the steady gain {gain.value:.3g}"
    return f"neither the input gain of {name} nor its damping is known"


def _undecided(axis: Axis) -> Weighed | None:
    """The likeliest law that tells gain and damping, where they are unknown only because other laws may hold as well.

    None where the delay is unknown, too, as in a feedback loop.
    """
    if len(axis.laws) < 2 or not (axis.status["delay"] == "ok" or _clocked(axis)):
        return None
    known = (law for law in sorted(axis.laws, key=lambda law: -law.weight) if _tells(law))
    return next(known, None)


def _tells(law: Weighed) -> bool:
    """Whether gain and damping have small errors under a law."""
    pairs = [(getattr(law.predictor, name), law.stderr.get(name)) for name in ("input", "damping")]
    return all(error is not None and error < WEAK_GAIN * abs(value) for value, error in pairs)


def _between_laws(axis: Axis, undecided: Weighed | None) -> str:
    """Why an interval is wide, to be appended to it; empty where it is wide under each law."""
    if undecided is None:
        return ""
    laws = ", ".join(f"{law.structure} {100 * law.weight:.0f} %" for law in axis.laws)
    return f": the data do not decide between laws ({laws}), and it covers all of them"


def _under(law: Weighed | None, coefficient: str, unit: str = "") -> str:
    """How to get a coefficient under one law; empty without one."""
    if law is None:
        return ""
    value = f"{getattr(law.predictor, coefficient):.3g}{unit}"
    use = f"fit with --structure {law.structure}, which gives {value}, if that law will do"
    return f"{use}; more flights decide between them"


def _delay_findings(name: str, axis: Axis, delay: float, flights: Sequence[Flight]) -> Iterator[Finding]:
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
            *too_early(flights, -delay),
            name,
        )
    elif axis.status["delay"] == "not_identifiable":
        yield Finding(
            "delay_not_identifiable",
            "info",
            f"the 95 % interval of the delay of {name} is {_end(low)} to {_end(high)} s",
            "delay and damping trade against each other in these data",
            "fly commands with steps or higher frequencies: slow sines hardly show a delay",
            name,
        )


def _trim_findings(name: str, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    """Finding that zero command is not hover: the sticks have an offset that the card does not say."""
    trims = [trim for trim in axis.trim if trim is not None]
    if not trims or not flights or axis.predictor is None or min(map(abs, trims)) < IMPOSSIBLE_TRIM:
        return
    if name not in flights[0].card.command:
        return
    command = flights[0].command[:, AXES.index(name)]
    if axis.status["input"] != "ok" or abs(np.mean(command)) < 2.0 * np.std(command):  # about 0, or hardly known
        return
    trim, channel = sum(trims) / len(trims), flights[0].card.command[name]
    if max(trims) - min(trims) > 0.2 * abs(trim):  # no one offset mends all flights
        return
    rest = -trim / axis.predictor.input
    unit = "rad/s^2" if name == "yaw" else "m/s^2"
    yield Finding(
        "zero_is_not_hover",
        "warning",
        f"with a command of 0, {name} accelerates by {trim:+.3g} {unit}, as no wind and no misalignment does; it is at "
        f"rest with {channel.raw(rest):.4g} in the log",
        f"input gain, damping and delay of {name} are right; plans and controllers take 0 for hover, which it is not",
        f"give {name} in [command] of the card offset = {channel.offset - rest / channel.factor:.6g} (now "
        f"{channel.offset:.6g})",
        name,
    )


def _start_findings(name: str, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    """Finding that a flight begins under a command that may not have been held, so that a long lag is not settled."""
    lag = axis.predictor.extra.get("lag", 0.0) if axis.predictor else 0.0
    if lag < LONG_LAG:
        return
    for flight in flights:
        first = np.searchsorted(flight.command_time, [part.start for part in flight.segments], side="right") - 1
        command = np.abs(flight.command[:, AXES.index(name)])
        moved = float(np.max(command[np.maximum(first, 0)]))
        if moved > SMALL_START * float(np.max(command)):
            yield Finding(
                "begins_in_motion",
                "warning",
                f"{flight.path}: a stretch begins with a command of {moved:.3g} on {name}, and its lag of {lag:.2g} s "
                "is taken to have settled under it before",
                f"if the command had only just been given, the intervals of {name} are too narrow",
                "begin the flight, or the span (LOG@T0:T1), in hover",
                name,
            )
            return


def _mode_findings(name: str, axis: Axis) -> Iterator[Finding]:
    chosen = next((mode for mode in axis.modes if mode.chosen), None)
    rivals = [mode for mode in axis.modes if not mode.chosen]
    if chosen is None or not rivals:
        return
    rival = max(rivals, key=lambda mode: mode.log_likelihood)
    above = rival.log_likelihood - chosen.log_likelihood
    if above > LIKELIHOOD_DOUBT and rival.prediction and chosen.prediction and rival.prediction > chosen.prediction:
        worse = rival.prediction / chosen.prediction
        by = f"{worse:.1f} times worse" if worse >= 1.05 else "hardly worse"
        yield Finding(
            "likelihood_and_prediction_disagree",
            "warning",
            f"the likelihood of {name} is {above:.0f} log units higher at a delay of {rival.delay:.3f} s; it predicts "
            f"{by} over 1 s than the delay of {chosen.delay:.3f} s",
            "the one that predicts better was taken; the other uses the commands of a feedback loop as a measurement",
            f"excite {name} from outside the feedback loop, with a reference that moves or an added signal",
            name,
        )


def _excitation_findings(name: str, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    error = axis.stderr["input"]
    if axis.input and error and _weak(axis):
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


def _slow_findings(name: str, k: int, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    """Commands without power at the frequencies where this model's delay or damping, if unknown, takes effect."""
    point = axis.predictor
    assert point is not None
    unknown = [part for part in ("damping", "delay") if axis.status.get(part) == "not_identifiable"]
    bands = {
        "damping": (point.damping / (2 * np.pi), "b/(2 pi)"),
        "delay": (1 / (4 * np.pi * max(point.delay, 0.05)), "half of 1/(2 pi tau)"),
    }
    rate = min(BLOCK_RATE, *(1 / float(np.median(np.diff(f.pose_time))) for f in flights))
    for part in unknown:
        frequency, formula = bands[part]
        share = max((share_above(f.command_time, f.command[:, k], frequency) for f in flights), default=0.0)
        if share < NEEDED_SHARE:
            yield Finding(
                "slow_commands",
                "warning",
                f"{100 * share:.2g} % of the power of the {name} command lies above {frequency:.2g} Hz, {formula}, "
                f"where the {part} of {name} shows; {100 * NEEDED_SHARE:g} % are needed",
                f"the {part} of {name} is not identifiable, and its error biases the others",
                f"command {name} with steps or sines that reach {2 * frequency:.2g} Hz"
                if 4 * frequency < rate
                else f"use the steady gain and the total lag of {name}: blocks of these poses show nothing above "
                f"{rate / 2:.2g} Hz",
                name,
            )
            return


def _feedback_findings(name: str, estimate: Estimate) -> Iterator[Finding]:
    found = estimate.loop
    if found.closed:
        yield Finding(
            "feedback",
            "info",
            f"the {name} command responds to the motion: beyond what its own past predicts, its changes correlate by "
            f"{found.correlation:+.2f} with the innovations {1e3 * found.lag / BLOCK_RATE:.0f} ms "
            f"before; all lags together, {found.sigmas:.0f} standard deviations of an open loop",
            f"the likelihood allows for it; regressions, including the paper's, bias gain and damping of {name}",
            "nothing for this model; in a loop an axis stays identifiable if a signal is added to its command from "
            "outside, as by `rotorfit plan`",
            name,
        )


def _paper_findings(fit: Fit, k: int) -> Iterator[Finding]:
    name, damping = AXES[k], fit.model.paper[2 * k + 1]
    axis, gain = fit.model.axes[name], fit.model.paper[2 * k]
    likely = METHODS[fit.model.method].likelihood  # a regression is biased itself
    if not likely or damping is None or gain is None or damping >= 0 or not axis.predictor:
        return
    lost = any(flight.clocks and flight.clocks.includes_delay for flight in fit.flights)
    lag = axis.predictor.extra.get("lag")
    late = axis.predictor.delay + (lag or 0.0)
    left = "the delay" if lag is None else "delay and lag"
    told = "" if lost else f" of {late:.2f} s" if lag is None else f", together {late:.2f} s"
    yield Finding(
        "paper_damping_negative",
        "info",
        f"the paper's regression gives {name} a damping of {damping:.2g} 1/s on the same data",
        f"it leaves out {left}{told}, which biases the damping; the likelihood does not",
        "use the model as it is; the paper's coefficients are there for comparison",
        name,
    )


def _bias_findings(method: str) -> Iterator[Finding]:
    bias = METHODS[method].bias
    if bias:
        yield Finding(
            "bias_not_in_interval",
            "warning" if method == "paper" else "info",
            f"fitted by {label_of(method)}, which is biased by {bias}",
            "the 95 % intervals hold the scatter of the method, not this bias: fewer than 95 % of them hold the truth"
            + (", next to none where a vehicle has a delay" if method == "paper" else ""),
            f"use --method {BEST}, whose intervals are counted to hold, or see the methods side by side in "
            "`rotorfit ladder`",
        )


def instrument_not_valid(fit: Fit, name: str) -> bool:
    """Whether the instrument of an axis is simulated from commands that seem to answer the motion."""
    told = COMMAND in fit.remarks.get(name, "") and fit.model.axes[name].predictor
    return bool(told) and seem_to_answer(fit.flights, name)


def _instrument_findings(fit: Fit, name: str) -> Iterator[Finding]:
    if instrument_not_valid(fit, name):
        yield Finding(
            "instrument_not_valid",
            "warning",
            f"the commands of {name} seem to answer its motion, and the instrument is simulated from them",
            f"the instrument then holds the wind that it should be free of: the coefficients of {name} are biased",
            "name what the controller was told in [reference] of the card, or use --method ml",
            name,
        )


def _unstable(name: str, gain: float, damping: float, certain: bool) -> Finding:
    return Finding(
        "damping_unstable",
        "error" if certain else "warning",
        f"the regression gives {name} a damping of {damping:.2g} 1/s and a gain of {gain:.3g}: speed grows by itself",
        "a multirotor does not do that: feedback, noise in the regressors, and above all a delay between command and "
        "motion that is left out pull the damping down",
        "use --method ml, which estimates the delay and keeps the damping positive",
        name,
    )


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.3g}"
