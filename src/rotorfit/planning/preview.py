"""The expected results of a plan as rows of text, shared by the terminal and the picture.

Also the picture of a plan: its commands, its path in the room, its speeds, and its expected results.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Plan, command_at, reference_at
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS, NORMAL
from rotorfit.core.writing import write_whole
from rotorfit.planning.belief import belief_from_mapping
from rotorfit.planning.envelope import Envelope, judges_of, predicted_path
from rotorfit.planning.precision import excited_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

UNITS = ("", " [1/s]", " [s]")
"""Units of the coefficients; the input has that of its command."""

EXPECTED_HEADS = tuple(f"{name}{unit}" for name, unit in zip(COEFFICIENTS, UNITS, strict=True))


UNDER_ONE_LAW = (
    "expected errors are those of `fit --structure first_order_delay`; the default fit weighs laws with a lag, too: "
    "its intervals of slow vehicles have been up to 6 times as wide for delays, twice for inputs; of those whose "
    "damping is that of a velocity loop 3 to 300 times, or open (then steady gain and total lag are what is known)"
)
"""Note below the expected errors of every plan."""


def expected_rows(plan: Plan) -> Iterator[tuple[str, ...]]:
    """Axis, and its believed coefficients with half the 95 % interval after the flight."""
    for axis, errors in plan.predicted["stderr"].items():
        a, belief = AXES.index(axis), plan.belief
        values = (*belief["gamma"][2 * a : 2 * a + 2], belief["delay"][a])
        yield axis, *(_plus_minus(v, NORMAL * errors[name]) for name, v in zip(COEFFICIENTS, values, strict=True))


def _plus_minus(value: float, half: float) -> str:
    """A value with half its interval, rounded to two digits of the latter."""
    decimals = max(0, min(6, 1 - math.floor(math.log10(half)))) if 0 < half < math.inf else 3
    return f"{value:.{decimals}f} +- {half:.{decimals}f}"


PICTURE_MARK = b"rotorfit plan"
"""Bytes near the start of a picture file, in lower case."""

COLOURS = {"x": "#0b57b7", "y": "#b4470b", "z": "#1a7f37", "yaw": "#6f42c1"}
"""Colours of the axes."""

STYLE: dict[Any, Any] = {
    "font.size": 8, "font.family": "sans-serif",
    "font.sans-serif": ["Arial", "Helvetica", "Liberation Sans", "DejaVu Sans"],
    "axes.labelsize": 8, "axes.titlesize": 8.5, "axes.titleweight": "bold", "axes.titlelocation": "left",
    "axes.linewidth": 0.6, "axes.grid": True, "axes.axisbelow": True, "axes.spines.top": False,
    "axes.spines.right": False, "grid.color": "#e4e4e4", "grid.linewidth": 0.4, "xtick.labelsize": 7,
    "ytick.labelsize": 7, "legend.fontsize": 7, "legend.frameon": False, "lines.linewidth": 1.0, "savefig.dpi": 160,
}  # fmt: skip


def check_picture_name(path: Path) -> None:
    """Refuses a name that is not one of a PNG.

    Raises:
        PlanError: The name has another suffix.
    """
    if path.suffix.lower() != ".png":
        raise PlanError(f"{path}: a picture is a PNG; name it {path.stem or 'plan'}.png")


def write_picture(plan: Plan, path: Path) -> None:
    """Draws the plan as PNG; the same plan gives the same bytes.

    Raises:
        PlanError: It has no valid belief.
        OSError: The file cannot be written.
    """
    import matplotlib as mpl

    belief = belief_from_mapping(plan.belief, f"plan {plan.name}")
    envelope = predicted_path(plan, judges_of(belief, plan.rate, plan.duration, plan.seed))
    with mpl.rc_context(STYLE):
        drawn = BytesIO()
        picture(plan, envelope).savefig(drawn, format="png", metadata={"Title": "rotorfit plan", "Software": None})
        write_whole(path, drawn.getvalue(), keep=False)


def picture(plan: Plan, envelope: Envelope) -> Figure:
    """The figure of a plan and its envelope."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7.2), layout="constrained")
    figure.suptitle(_headline(plan), x=0.01, ha="left", fontsize=10, fontweight="bold")
    grid = figure.add_gridspec(3, 2, height_ratios=(1.0, 1.0, 1.3), width_ratios=(1.75, 1.0))
    axes = excited_axes(plan)
    _signals(figure.add_subplot(grid[0, 0]), plan, axes)
    _motion(figure.add_subplot(grid[1, 0]), envelope, axes)
    _table(figure.add_subplot(grid[0, 1]), plan)
    _speeds(figure.add_subplot(grid[1, 1]), plan)
    _view(figure.add_subplot(grid[2, 0]), plan, envelope, (0, 1))
    _view(figure.add_subplot(grid[2, 1]), plan, envelope, (0, 2))
    return figure


def _headline(plan: Plan) -> str:
    return f"{plan.name}, {plan.duration:g} s, for {plan.card.get('name', 'a vehicle')}"


def _signals(panel: Axes, plan: Plan, axes: tuple[str, ...]) -> None:
    """The commands, or the position references, over time."""
    t = np.arange(0.0, plan.duration, 1 / plan.rate)
    positions = {each.axis for each in plan.excitations if each.target == "position"}
    command, reference = command_at(plan, t), reference_at(plan, t)[0]
    for axis in axes:
        a = AXES.index(axis)
        series: Array = reference[:, a] if axis in positions else command[:, a]
        panel.plot(t, series, color=COLOURS[axis], label=axis)
    panel.set_title("position references, from the start [m, rad]" if positions else "commands of the signals")
    _over_time(panel, plan.duration)


def _over_time(panel: Axes, duration: float) -> None:
    panel.set_xlim(0, duration)
    panel.set_xlabel("time [s]")
    panel.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=4, borderaxespad=0)


def _motion(panel: Axes, envelope: Envelope, axes: tuple[str, ...]) -> None:
    """Expected position of the excited axes relative to the start, with the 95 % band."""
    for axis in axes:
        a = AXES.index(axis)
        begin = envelope.nominal[0, a]
        panel.fill_between(
            envelope.time, envelope.low[:, a] - begin, envelope.high[:, a] - begin, color=COLOURS[axis], alpha=0.18,
            linewidth=0,
        )  # fmt: skip
        panel.plot(envelope.time, envelope.nominal[:, a] - begin, color=COLOURS[axis], label=axis)
    panel.set_title("expected motion [m, rad], band: 95 %")
    _over_time(panel, float(envelope.time[-1]))


def _table(panel: Axes, plan: Plan) -> None:
    """Table of the coefficients after the flight."""
    from matplotlib.transforms import Bbox

    panel.axis("off")
    panel.set_title("told by this flight alone, 95 % intervals")
    rows = [[cell.replace("+-", "\u00b1") for cell in row] for row in expected_rows(plan)]
    cells = [["", *EXPECTED_HEADS], *rows]
    height = 0.17 * len(cells)
    table = panel.table(
        cells,
        colWidths=[0.07, 0.29, 0.29, 0.35],
        bbox=Bbox.from_bounds(0.0, 1.0 - height, 1.0, height),
        cellLoc="right",
        edges="horizontal",
    )
    table.auto_set_font_size(False)
    table.set_fontsize(6.5)
    for place, cell in table.get_celld().items():
        cell.set_edgecolor("#d5d5d5")
        cell.set_linewidth(0.5)
        if place[0] == 0 or place[1] == 0:
            cell.set_text_props(weight="bold")
    notes = [f"believed: {plan.belief.get('source', '')}", *plan.predicted.get("notes", ()), UNDER_ONE_LAW]
    text = "\n".join(line for note in notes for line in textwrap.wrap(note, 62))
    panel.text(0.0, 0.93 - height, text, va="top", fontsize=6.5, color="#555555", transform=panel.transAxes)


def _speeds(panel: Axes, plan: Plan) -> None:
    """Largest speeds beside their limits."""
    nominal, high = plan.predicted["speed"], plan.predicted["speed_high"]
    names = ("horizontal", "vertical", "yaw")
    place = np.arange(3)
    panel.barh(place, [high[name] for name in names], height=0.55, color="#0b57b7", alpha=0.25, label="95 %")
    panel.barh(place, [nominal[name] for name in names], height=0.25, color="#0b57b7", label="likeliest")
    for row, limit in enumerate((plan.space.speed, plan.space.climb)):
        panel.plot(
            [limit, limit], [row - 0.4, row + 0.4], color="#b4470b", linewidth=1.6, label="limit" if not row else None
        )
    panel.set_yticks(place, ["along x, y [m/s]", "along z [m/s]", "yaw [rad/s]"])
    panel.invert_yaxis()
    panel.grid(axis="y", visible=False)
    panel.set_title("speeds")
    panel.legend(loc="lower right", bbox_to_anchor=(1, 0.98), ncols=3, borderaxespad=0)


def _view(panel: Axes, plan: Plan, envelope: Envelope, pair: tuple[int, int]) -> None:
    """The room from above, or from the side: the fence, the middle 95 % of the flights, the likeliest path."""
    i, j = pair
    space = plan.space
    _box(panel, (space.lower[i], space.lower[j]), (space.upper[i], space.upper[j]), "#b4470b", "fence")
    low, high = envelope.extent
    label = f"middle 95 %; {round(envelope.leaving * envelope.draws)} of {envelope.draws} leave"
    _box(panel, (low[i], low[j]), (high[i], high[j]), "#0b57b7", label, filled=True)
    panel.plot(envelope.nominal[:, i], envelope.nominal[:, j], color="#0b57b7", linewidth=0.7, label="likeliest path")
    panel.plot(space.start[i], space.start[j], "o", color="black", markersize=3, label="start")
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel(f"{AXES[i]} [m]")
    panel.set_ylabel(f"{AXES[j]} [m]")
    panel.set_title("from above" if j == 1 else "from the side")
    if j == 1:
        panel.legend(loc="lower right", bbox_to_anchor=(1, 1.0), ncols=4, borderaxespad=0)


def _box(
    panel: Axes, low: tuple[float, float], high: tuple[float, float], colour: str, label: str, filled: bool = False
) -> None:
    x, y = (low[0], high[0], high[0], low[0], low[0]), (low[1], low[1], high[1], high[1], low[1])
    if filled:
        panel.fill(x, y, color=colour, alpha=0.14, linewidth=0, label=label)
    else:
        panel.plot(x, y, color=colour, linewidth=1.2, label=label)
