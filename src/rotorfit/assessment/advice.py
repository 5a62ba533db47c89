"""What the data can and cannot show: findings from a fit and its flights."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.assessment.coefficient_findings import coefficient_findings, excitation_findings, is_weak
from rotorfit.assessment.constancy import EVENT, ONE, TWICE, changed_coefficients, command_events, widening
from rotorfit.assessment.flight_differences import disagreement_findings, turned_findings
from rotorfit.assessment.frequency.loop import seem_to_answer
from rotorfit.assessment.law_findings import contradicted, law_findings, with_size
from rotorfit.assessment.mismatch import findings_of_left_out
from rotorfit.assessment.plausibility import findings_of_settings
from rotorfit.assessment.prior_influence import prior_findings
from rotorfit.assessment.tilt_limit import findings_of_tilt
from rotorfit.core.finding import OTHER_STAMPS, WRONG_FRAME, Finding, by_gravity
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.frozen import frozen_axes, with_frozen
from rotorfit.core.model import Axis, first_order_beside, with_findings
from rotorfit.core.results import Fit
from rotorfit.diagnosis.command_checks import share_above
from rotorfit.diagnosis.frame_checks import OVER, remedy_in_the_pose
from rotorfit.diagnosis.position_loop import restored_axes
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import BLOCK_RATE
from rotorfit.estimation.likelihood.outliers import outlier_findings
from rotorfit.estimation.methods import BEST, METHODS, label_of
from rotorfit.estimation.regression.instrumental_variables import COMMAND
from rotorfit.estimation.zero_command import findings_of_braking

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
    turned = {finding.axis: finding for finding in turned_findings(fit)}
    told = [one for one in before if not (_settled(one, fit) or (one.code == "sign_flipped" and one.axis in turned))]
    found = [*told, *turned.values()]
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
        if name in turned:  # everything else follows from that
            continue
        if not (name in misread and axis.status["input"] == "not_excited"):
            found += _status_findings(name, axis, flights, fit.remarks.get(name, ""))
        found += _event_findings(name, axis, flights)
        changed = list(changed_coefficients(fit, name)) if name not in wrong else []
        if axis.predictor and name not in wrong:
            found += () if overturned and name in OVER else _sign_findings(fit, name, axis)
            known = coefficient_findings(name, axis, flights)
            found += (one for one in known if not (clocked and one.code in ABOUT_DELAY))  # the clocks say why
            found += _mode_findings(name, axis)
            found += _trim_findings(name, axis, flights)
            found += _start_findings(name, axis, flights)
            found += excitation_findings(name, axis, flights)
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
    found += (one for one in disagreement_findings(fit) if one.axis not in turned)
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
    return all(status == "ok" for status in axis.status.values()) and not is_weak(axis)


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
