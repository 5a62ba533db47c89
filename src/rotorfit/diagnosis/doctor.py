"""The data doctor before any fit: faults of a flight, in numbers, and remedies.

A check is a function `findings(recording) -> Iterator[Finding]` in a module of its own and one row in `CHECKS`.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

from rotorfit.core.finding import DAMAGED, Finding, by_gravity
from rotorfit.core.flight_data import Flight
from rotorfit.core.frozen import frozen_axes
from rotorfit.core.log import Log
from rotorfit.diagnosis.clock_checks import clock_findings
from rotorfit.diagnosis.command_checks import command_findings
from rotorfit.diagnosis.frame_checks import frame_findings, sign_findings
from rotorfit.diagnosis.motion_checks import motion_findings
from rotorfit.diagnosis.pose_checks import pose_findings
from rotorfit.diagnosis.position_loop import restoring_findings
from rotorfit.diagnosis.recording import Recording, recording_of
from rotorfit.diagnosis.response_time import response_time_findings

SHORT_TIME = 20.0
"""Flight time below which a flight counts as short [s]."""


def findings_of_flight(log: Log, flight: Flight) -> tuple[Finding, ...]:
    """All findings on a flight before any fit, the most severe first.

    Args:
        log: As recorded.
        flight: The flight read from it.
    """
    return by_gravity(
        finding if finding.code == DAMAGED else replace(finding, evidence=f"{flight.path}: {finding.evidence}")
        for finding in _found(recording_of(log, flight))
    )


def faults_of(flight: Flight) -> tuple[Finding, ...]:
    """What can be found without a log, as of a flight that is not over, the most severe first."""
    return by_gravity(_found(recording_of(None, flight)))


def _found(recording: Recording) -> list[Finding]:
    """What all checks find, except what follows from something else that is found."""
    found = {check: tuple(check(recording)) for check in CHECKS}
    if found[
        frame_findings
    ]:  # a wrong frame makes signs look reversed, shifts responses and leaves the horizontal motion unexplained
        found[sign_findings] = found[response_time_findings] = ()
        found[motion_findings] = tuple(
            finding
            for finding in found[motion_findings]
            if not (finding.code == "wind_dominates" and finding.axis in ("x", "y"))
        )
    still = frozen_axes(found[pose_findings])
    for check in (motion_findings, sign_findings, response_time_findings):
        found[check] = tuple(finding for finding in found[check] if finding.axis not in still)
    if "x" in still:
        found[frame_findings] = ()
    return [finding for findings in found.values() for finding in findings]


def damage_of(log: Log) -> Finding | None:
    """What is lost from a damaged log; None where it is whole."""
    if not log.damage:
        return None
    return Finding(
        "log_damaged",
        "warning",
        f"{log.path}: {'; '.join(log.damage)}",
        "the lost part is missing from the analysis: the flight is shorter, or has a hole",
        "copy or download the log again from where it was recorded; else go on with what is there",
    )


def _damage_findings(recording: Recording) -> Iterator[Finding]:
    if recording.log and (damage := damage_of(recording.log)):
        yield damage


def _duration_findings(recording: Recording) -> Iterator[Finding]:
    if recording.flight.duration < SHORT_TIME:
        yield Finding(
            "short_data",
            "warning",
            f"{recording.flight.duration:.1f} s of flight under commands",
            "intervals of all coefficients are wide, and optimistic where the disturbance is slow",
            "fly for a minute or more, or fit several flights together",
        )


CHECKS: tuple[Callable[[Recording], Iterator[Finding]], ...] = (
    _damage_findings,
    _duration_findings,
    clock_findings,
    command_findings,
    pose_findings,
    motion_findings,
    frame_findings,
    sign_findings,
    response_time_findings,
    restoring_findings,
)
"""Every check of the data before a fit; findings of equal severity appear in this order."""
