"""Fit -> findings: which coefficients of an axis are known, and why the others are not.

Also why a vehicle seems to respond before its command: clocks that disagree, or commands that are logged too rarely.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from rotorfit.assessment.summary import is_told
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import NORMAL, Axis, Combination, Weighed
from rotorfit.diagnosis.doctor import SHORT_TIME
from rotorfit.estimation.likelihood.coefficients import statuses

ONE_CLOCK = (".ulg", ".bin")
"""Suffixes of autopilot logs: one clock stamps everything in them."""

WEAK_GAIN = 0.2
"""Relative standard error of the input gain above which the excitation is called weak."""

FAR_INSIDE = 0.25
"""How far an open interval of a delay reaches into the range for its bound to prove nothing [s]: in simulated flights
outdoors one reached 0.3 s inside with clocks that were right; of x and y with clocks 0.25 or 0.5 s apart none beyond
0.21 s."""


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


def coefficient_findings(name: str, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    """Findings on the coefficients of an axis with numbers: impossible ones, and those that are not identifiable."""
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


def excitation_findings(name: str, axis: Axis, flights: Sequence[Flight]) -> Iterator[Finding]:
    """Findings on how well the commands of an axis determine its gain, and for how long they move it."""
    error = axis.stderr["input"]
    if axis.input and error and is_weak(axis):
        share = f"the input gain of {name} is known to {100 * error / abs(axis.input):.0f} % only"
        gain, lag = (_told(axis, part) for part in ("steady_gain", "total_lag"))
        if "lag" in axis.extra and gain and lag and max(_error(gain), _error(lag)) < 0.5 * WEAK_GAIN:
            yield Finding(
                "parts_trade_off",
                "info",
                f"{share}, its steady gain to {100 * _error(gain):.2g} % and its total lag to "
                f"{100 * _error(lag):.2g} % (standard errors)",
                f"lag and damping of {name} are two poles near each other, and to exchange them changes little: input, "
                "damping and lag are wide, but not what they do together",
                "nothing, unless you need the parts: then fly longer, and larger commands; predictions and controllers "
                "depend on what is known",
                name,
            )
        else:
            yield Finding(
                "weak_excitation",
                "warning",
                share,
                f"all coefficients of {name} are wide",
                "fly longer on this axis, with commands too small to reach the limit that the flights show"
                if any(one.test == "bound" for one in axis.evidence)
                else "fly larger or longer commands on this axis",
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


def is_weak(axis: Axis) -> bool:
    """Whether the input gain is badly known."""
    error = axis.stderr.get("input")
    return bool(axis.input and error and error > WEAK_GAIN * abs(axis.input))


def _clocked(axis: Axis) -> bool:
    """Whether the delay of an axis is open because it cannot be told from the offset of two clocks."""
    return "offset_plus_delay" in axis.combinations


def _told(axis: Axis, name: str) -> Combination | None:
    """A combination of the axis that the summary tells, too; else None."""
    part = axis.combinations.get(name)
    return part if part and is_told(name, part) else None


def _error(part: Combination) -> float:
    """Standard error of a combination with a closed interval, over its value."""
    low, high = part.ci95
    assert low is not None
    assert high is not None
    return 0.5 * (high - low) / (NORMAL * abs(part.value))


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
    at_bound = min(abs(delay - end) for end in DELAY_RANGE) < 1e-6
    flat = axis.status["delay"] == "not_identifiable" and _reaches_far_inside(low, high)
    if at_bound and not flat:
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
        sure = all(_one_clock(flight) for flight in flights)
        yield Finding(
            "delay_not_identifiable",
            "warning" if at_bound and not sure else "info",
            f"the 95 % interval of the delay of {name} is {_end(low)} to {_end(high)} s"
            + f", and its likeliest value the bound of its range, {delay:.2f} s" * at_bound,
            "delay and damping trade against each other in these data",
            "fly commands with steps or higher frequencies: slow sines hardly show a delay"
            + "; check the clocks of commands and poses, too" * (at_bound and not sure),
            name,
        )


def _reaches_far_inside(low: float | None, high: float | None) -> bool:
    """Whether an open interval of a delay holds values far from the end of the range at which it is open."""
    first, last = DELAY_RANGE
    if low is not None:
        return high is None and low < last - FAR_INSIDE
    return high is None or high > first + FAR_INSIDE


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
