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


def told_together(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Findings to be shown: those that say the same of several axes are one, which names all of them."""
    groups: dict[tuple[object, ...], list[Finding]] = {}
    for number, finding in enumerate(findings):
        words = (finding.evidence, finding.effect, finding.remedy)
        alike = [re.sub(rf"\b{finding.axis}\b", "\0", text) for text in words] if finding.axis else []
        own = () if alike and "\0" in alike[0] else (number,)  # it does not name its axis: nothing to add others to
        groups.setdefault((finding.code, finding.severity, *alike, *own), []).append(finding)
    return tuple(_of_all(group) if len(group) > 1 else group[0] for group in groups.values())


def _of_all(group: Sequence[Finding]) -> Finding:
    """One finding for several that differ in their axis only."""
    first, axes = group[0], listed([str(finding.axis) for finding in group])
    evidence, effect, remedy = (
        re.sub(rf"\b{first.axis}\b", axes, text) for text in (first.evidence, first.effect, first.remedy)
    )
    return replace(first, evidence=evidence, effect=effect, remedy=remedy, axis=None)


def by_gravity(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sorts findings by severity: error, warning, info; otherwise the order is kept."""
    rank = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(findings, key=lambda finding: rank[finding.severity]))
