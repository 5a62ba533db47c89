"""Finding: one thing that the user should know about a flight or a fit, with its evidence."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["info", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """What was noticed, how it is known, what it does to the answer, and what helps.

    Attributes:
        code: Short stable name, `snake_case`, such as `damping_unstable`.
        severity: `info`, `warning`, or `error` (the numbers concerned must not be used).
        evidence: The numbers behind it, one sentence.
        effect: What it does to which coefficient, one sentence.
        remedy: What to try, one sentence.
        axis: `x`, `y`, `z` or `yaw`; None where it concerns the flight as a whole.
    """

    code: str
    severity: Severity
    evidence: str
    effect: str
    remedy: str
    axis: str | None = None


def gravity(finding: Finding) -> int:
    """Place of a finding in a list that starts with the gravest."""
    return ("error", "warning", "info").index(finding.severity)
