"""Finding: one fact that the user should know about a flight or a fit, with its evidence."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Literal

from rotorfit.core.plain import listed

Severity = Literal["info", "warning", "error"]

DAMAGED = "log_damaged"
"""The finding that is shown before all others: it concerns missing data."""

WRONG_PLANE = ("axes_exchanged", "command_frame", "yaw_offset")
"""Findings that commands or pose of x and y are read in a wrong frame; z and yaw are right."""

WRONG_FRAME = (*WRONG_PLANE, "mirrored_pose", "quaternion_order")
"""Findings that a frame is wrong: what x and y seem to do follows from that."""

MISREAD = (*WRONG_FRAME, "axes_turned", "sign_flipped", "unit_mistake", "pose_frozen")
"""Findings that what was recorded means something else than the card says, or nothing: they are told in flight."""

OTHER_STAMPS = ("commands_by_row", "repeated_commands", "commands_interpolated")
"""Findings of commands that do not bear their own stamps: what delays owe to them no flight of this logger tells."""


@dataclass(frozen=True)
class Finding:
    """An observation, its evidence, its effect on the estimates, and a remedy.

    Attributes:
        code: Short stable name, `snake_case`, such as `damping_unstable`.
        severity: `info`, `warning`, or `error` (the numbers concerned must not be used).
        evidence: The numbers behind it, one sentence.
        effect: Its effect on which coefficient, one sentence.
        remedy: What to try, one sentence.
        axis: `x`, `y`, `z` or `yaw`; None where it concerns the flight as a whole.
    """

    code: str
    severity: Severity
    evidence: str
    effect: str
    remedy: str
    axis: str | None = None

    def _repr_html_(self) -> str:
        where = f" ({self.axis})" if self.axis else ""
        said = f"{self.evidence}; {self.effect}; {self.remedy}"
        return f"<b>{self.severity}</b> <code>{escape(self.code)}</code>{where}: {escape(said)}"

    @property
    def line(self) -> str:
        """One line: how severe it is, what was seen, and what to do."""
        return f"{self.severity} {self.code}: {self.evidence}; {self.remedy}"


def told_together(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings to be shown: those of several axes with one effect and one remedy are one, which names all of them.

    Evidence that differs is told of each axis, on a line of its own.
    """
    groups: dict[tuple[object, ...], list[Finding]] = {}
    for number, finding in enumerate(findings):
        named = finding.axis is not None and _of(finding.axis, "\0", finding.evidence) != finding.evidence
        alike = [_of(str(finding.axis), "\0", text) for text in (finding.effect, finding.remedy)]
        own = () if named else (number,)  # it does not name its axis: nothing to add others to
        groups.setdefault((finding.code, finding.severity, *alike, *own), []).append(finding)
    return tuple(_of_all(group) if len(group) > 1 else group[0] for group in groups.values())


def _of_all(group: Sequence[Finding]) -> Finding:
    """One finding for several with the same effect and remedy."""
    first = group[0]
    by_evidence: dict[str, list[Finding]] = {}
    for finding in group:
        by_evidence.setdefault(_of(str(finding.axis), "\0", finding.evidence), []).append(finding)
    told = [_of(str(same[0].axis), _axes(same), same[0].evidence) for same in by_evidence.values()]
    log = told[0].partition(": ")[0] + ": "
    later = told[1:]
    if all(line.startswith(log) for line in later):
        later = [line.removeprefix(log) for line in later]  # all of one log
    evidence = ";\n".join([told[0], *later])
    effect, remedy = (_of(str(first.axis), _axes(group), text) for text in (first.effect, first.remedy))
    alone = first.axis if {finding.axis for finding in group} == {first.axis} else None  # on several flights
    return replace(first, evidence=evidence, effect=effect, remedy=remedy, axis=alone)


def _axes(group: Sequence[Finding]) -> str:
    return listed(list(dict.fromkeys(str(finding.axis) for finding in group)))


def _of(axis: str, other: str, text: str) -> str:
    """The text with another name in the place of the axis's."""
    return re.sub(rf"\b{axis}\b", other, text)


def by_gravity(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sorts findings by severity: error, warning, info; otherwise the order is kept."""
    rank = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(findings, key=lambda finding: rank[finding.severity]))
