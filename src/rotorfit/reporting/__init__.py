"""Evidence to one HTML page to send on, and figures for a paper.

In go the values that the assessment computed; out come a self-contained page, PNG and PDF. Nothing is estimated,
filtered or predicted here.
"""

from collections.abc import Sequence
from pathlib import Path

from rotorfit.assessment.evidence import Evidence
from rotorfit.core.flight_data import Flight
from rotorfit.core.tracked import Track
from rotorfit.core.writing import write_whole

__all__ = ["write_figures", "write_report", "write_timeline"]


def write_report(evidences: Sequence[Evidence], path: Path) -> Path | None:
    """Writes one self-contained HTML page: verdict, evidence, what to fly next, coefficients, findings, repairs.

    The page asks nothing of the network, works from a mail attachment, prints, and follows the reader's light or dark
    setting. Charts of flights zoom where scripts may run and are pictures where they may not.

    Args:
        evidences: As `evidence_of` gives them, for one model or for several on the same flights, side by side.
        path: Of the page.

    Returns:
        Where the page that it replaces is kept; None where there was none.
    """
    from rotorfit.reporting.page import page

    return write_whole(path, page(evidences))


def write_timeline(track: Track, flight: Flight, path: Path, files: Sequence[Path | None] = ()) -> Path | None:
    """Writes one self-contained HTML page about a tracked flight: what is known now, over time, alarms, regimes.

    Args:
        track: Of the flight.
        flight: As it was recorded.
        path: Of the page.
        files: Of each regime its model's, where it was written.

    Returns:
        Where the page that it replaces is kept; None where there was none.
    """
    from rotorfit.reporting.timeline import timeline_page

    return write_whole(path, timeline_page(track, flight, files))


def write_figures(evidence: Evidence, directory: Path) -> list[Path]:
    """Writes figures for a paper, each as PNG and PDF; those without content are left out.

    Among them is the layout of the paper's Figure 4: measured against modelled acceleration in world axes for x, y, z
    and yaw, each on the validation flight that moves it most; on the training flights where there are no others.

    Args:
        evidence: Of one model.
        directory: Where to write; made where it is missing.

    Returns:
        The files written.
    """
    from rotorfit.reporting.figures import figures

    return figures(evidence, directory)
