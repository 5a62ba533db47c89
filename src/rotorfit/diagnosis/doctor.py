"""The data doctor before any fit: what is wrong with a flight, in numbers, and what to do about it."""

from dataclasses import replace

from rotorfit.core.card import Card
from rotorfit.core.finding import DAMAGED, Finding, by_gravity
from rotorfit.core.flight_data import Flight
from rotorfit.core.log import Log
from rotorfit.diagnosis.clock_checks import clock_findings
from rotorfit.diagnosis.command_checks import command_findings
from rotorfit.diagnosis.frame_checks import frame_findings, sign_findings
from rotorfit.diagnosis.motion_checks import motion_findings
from rotorfit.diagnosis.pose_checks import pose_findings
from rotorfit.diagnosis.position_loop import restoring_findings
from rotorfit.dynamics.kinematics import motion_from_flight

SHORT_TIME = 20.0
"""Flight time below which it is called short [s]."""


def findings_of_flight(log: Log, card: Card, flight: Flight) -> tuple[Finding, ...]:
    """Everything that a flight tells of itself before any fit, the gravest first.

    Args:
        log: As recorded.
        card: That was applied.
        flight: What came of it.
    """
    motion = motion_from_flight(flight)
    framed = tuple(frame_findings(card, flight, motion))
    found = [
        *damage_findings(log),
        *_short(flight),
        *clock_findings(log, card, flight),
        *command_findings(card, flight),
        *pose_findings(flight, motion),
        *(
            finding
            for finding in motion_findings(flight, motion)
            if not (framed and finding.code == "wind_dominates" and finding.axis in ("x", "y"))  # the frame says why
        ),
        *framed,
        *(() if framed else sign_findings(card, flight, motion)),
        *restoring_findings(flight, motion),
    ]
    return by_gravity(
        finding if finding.code == DAMAGED else replace(finding, evidence=f"{flight.path}: {finding.evidence}")
        for finding in found
    )


def damage_findings(log: Log) -> tuple[Finding, ...]:
    """What is lost of a damaged log; nothing where it is whole."""
    if not log.damage:
        return ()
    return (
        Finding(
            "log_damaged",
            "warning",
            f"{log.path}: {'; '.join(log.damage)}",
            "what is lost is missing from all that follows: the flight is shorter, or has a hole",
            "copy or download the log again from where it was recorded; else go on with what is there",
        ),
    )


def _short(flight: Flight) -> list[Finding]:
    if flight.duration >= SHORT_TIME:
        return []
    return [
        Finding(
            "short_data",
            "warning",
            f"{flight.duration:.1f} s of flight under commands",
            "intervals of all coefficients are wide, and optimistic where the disturbance is slow",
            "fly for a minute or more, or fit several flights together",
        )
    ]
