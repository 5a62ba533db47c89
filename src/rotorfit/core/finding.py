"""Finding: one fact that the user should know about a flight or a fit, with its evidence."""

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from typing import Literal

Severity = Literal["info", "warning", "error"]

DAMAGED = "log_damaged"
"""The finding that is shown before all others: it concerns missing data."""


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


def by_gravity(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sorts findings by severity: error, warning, info; otherwise the order is kept."""
    rank = {"error": 0, "warning": 1, "info": 2}
    return tuple(sorted(findings, key=lambda finding: rank[finding.severity]))
