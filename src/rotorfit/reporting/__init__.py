"""Reporting: from evidence to one HTML page that can be passed on, and to figures for a paper.

The values that the assessment computed go in; a self-contained page, PNG and PDF come out. Nothing is estimated,
filtered or predicted here.
"""

from collections.abc import Sequence
from pathlib import Path

from rotorfit.assessment.evidence import Evidence
from rotorfit.core.flight_data import Flight
from rotorfit.core.tracked import Track
from rotorfit.core.writing import write_result

__all__ = ["write_figures", "write_report", "write_timeline"]


def write_report(evidences: Sequence[Evidence], path: Path) -> Path | None:
    """Writes one self-contained HTML page: verdict, evidence, what to fly next, coefficients, findings, repairs.

    The page needs no network, works from a mail attachment, prints, and follows the reader's light or dark setting.
    Charts of flights can be zoomed if scripts may run, and are static pictures otherwise.

    Args:
        evidences: As `evidence_of` gives them, for one model or for several on the same flights, side by side.
        path: Path of the page.

    Returns:
        Path at which a replaced page is kept; None if there was none.
    """
    from rotorfit.reporting.page import page

    return write_result(path, page(evidences))


def write_timeline(
    track: Track, flight: Flight, path: Path, files: Sequence[Path | None] = (), again: Sequence[str] = ()
) -> Path | None:
    """Writes one self-contained HTML page about a tracked flight: final state, estimates over time, alarms, regimes.

    Args:
        track: The track.
        flight: The flight as recorded.
        path: Path of the page.
        files: Model file of each regime, or None.
        again: Log and options of `rotorfit track` for this flight; default: the flight's path alone.

    Returns:
        Path at which a replaced page is kept; None if there was none.
    """
    from rotorfit.reporting.timeline import timeline_page

    return write_result(path, timeline_page(track, flight, files, again))


def write_figures(evidence: Evidence, directory: Path) -> list[Path]:
    """Writes figures for a paper, each as PNG and PDF; those without content are left out.

    One has the layout of the paper's Figure 4: measured against modelled acceleration in world axes for x, y, z and
    yaw, each on the validation flight that moves it most, or on a training flight if there are no others.

    Args:
        evidence: Evidence of one model.
        directory: Where to write; created if it is missing.

    Returns:
        The files written.
    """
    from rotorfit.reporting.figures import figures

    return figures(evidence, directory)
