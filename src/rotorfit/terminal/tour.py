"""What the terminal shows of the demo: the truth beside the estimates."""

import math
from pathlib import Path

from rotorfit.demo import Demo, recovered, scores
from rotorfit.model import Interval
from rotorfit.terminal.tables import View, bullets, indented, interval_text, number_text, table, three_digits, title


def demo_view(demo: Demo) -> View:
    """Truth beside the estimates, errors on the validation flights, and what was written."""
    out = table("axis", "coefficient", "truth", "likelihood", "95 % interval", "", "paper's method", left=(0, 1, 5))
    rows = recovered(demo)
    for row in rows:
        axis, _, name = row.name.partition(".")
        out.add_row(
            axis if name == "input" else "",
            name,
            f"{row.truth:.4g}",
            "-" if row.ml is None else number_text(row.ml, row.ci95),
            interval_text(row.ci95),
            "" if _inside(row.truth, row.ci95) else "missed",
            "-" if row.paper is None else f"{row.paper:.3g}",
        )
    inside = sum(_inside(row.truth, row.ci95) for row in rows)
    yield title("Six simulated flights, three to fit and three for the proof. What came back:")
    yield out
    yield indented("input in m/s^2 (yaw rad/s^2) per command of 1, damping in 1/s, delay in s", 0, "dim")
    yield indented(f"{inside} of {len(rows)} intervals hold the truth; of many, 95 % must.", 0)
    yield ""
    yield title("1 s predictions of the velocity on flights that were not fitted:")
    errors = table("axis", "likelihood", "paper's method", "velocity held", "flight", left=(0, 4))
    for score in scores(demo):
        scale = 180 / math.pi if score.axis == "yaw" else 100.0
        cells = ["-" if v is None else three_digits(scale * v) for v in (score.ml, score.paper, score.hold)]
        errors.add_row(score.axis, *cells, Path(score.path).name)
    yield errors
    yield indented("RMSE in cm/s (yaw deg/s); a velocity that is held is the naive prediction", 0, "dim")
    yield ""
    yield title("Written:")
    yield from bullets([str(path) for path in demo.written])


def _inside(value: float, interval: Interval) -> bool:
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)
