"""Flight: commands and poses of a vehicle on one clock, in SI units, with every repair as a note."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np

from rotorfit.core.display import (
    AXIS_COLOURS,
    FrameLibrary,
    Line,
    Panel,
    counted,
    frame,
    html_table,
    line_panels,
    short_repr,
)
from rotorfit.core.frames import AXES, Array

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.axes import Axes

    from rotorfit.core.card import Card
    from rotorfit.core.finding import Finding


@dataclass(frozen=True)
class Note:
    """A repair of the data, or a remark on a flight.

    Attributes:
        code: Short stable name, such as `stale_poses`.
        text: One sentence with the count in it.
        count: How many samples it concerns.
    """

    code: str
    text: str
    count: int


ANSWER = 0.2
"""Delay assumed between a command and the response [s] where only the response reveals the clock offset: well inside
the range of delays that the likelihood searches, whatever the true delay is."""

AGREES = 0.002
"""Offset below which two clocks count as equal, whatever the interval [s]."""


@dataclass(frozen=True)
class Clocks:
    """Offset between the clock of the commands and that of the poses, for a flight in several files.

    Attributes:
        source: What revealed the offset: `onboard` (velocity or heading from the vehicle's own sensors), `command` (the
            response to the commands) or `none`.
        offset: Added to the stamp of a command at `middle`, it gives the stamp on the clock of the poses [s].
        half_width: Half the 95 % interval of the offset [s]; 0 where only the response to the commands revealed it,
            roughly.
        drift: Change of the offset per second; 0 likewise.
        drift_half_width: Half the 95 % interval of the drift.
        middle: Middle of the commands, counted from the first [s].
        moved: Whether the stamps of the commands were shifted.
        stated: Why the clocks are taken to be the same, as a clause; empty where each file has its own.
        explained: Witness to the share of its variance that the motion of the poses explains.
        later: Onboard sensor that was left out because it lags the others, to its lag [s].
        refused: Why the vehicle's own sensors did not reveal the offset, as a clause; empty where they did, or where
            there are none.
    """

    source: str
    offset: float = 0.0
    half_width: float = 0.0
    drift: float = 0.0
    drift_half_width: float = 0.0
    middle: float = 0.0
    moved: bool = False
    stated: str = ""
    explained: Mapping[str, float] = field(default_factory=dict)
    later: Mapping[str, float] = field(default_factory=dict)
    refused: str = ""

    @property
    def includes_delay(self) -> bool:
        """Whether the offset that was removed includes the delay."""
        return self.moved and self.source == "command"

    @property
    def with_delay(self) -> float:
        """Offset plus delay [s]: the measured quantity where only the response to the commands revealed the offset."""
        return self.offset + ANSWER

    @property
    def differs(self) -> bool:
        """Whether the clocks differ by more than their intervals."""
        grown = abs(self.drift) * 2 * self.middle
        return self.source != "none" and (
            abs(self.offset) > max(self.half_width, AGREES)
            or (abs(self.drift) > self.drift_half_width and grown > AGREES)
        )


@dataclass(frozen=True)
class Velocity:
    """Velocity measured by the vehicle itself, on its own clock.

    Attributes:
        time: Strictly increasing stamps, shape (V,) [s].
        value: World x, y, z and yaw rate, shape (V, 4), NaN for axes without a measurement [m/s, rad/s].
        grain: Rounding step of each axis where it is coarse, else 0, shape (4,) [m/s, rad/s].
        alone: Axes that have a velocity but no position.
        late: Lag of each axis behind the pose, shape (4,) [s]; None until it has been estimated.
        late_error: Half the 95 % interval of `late`, shape (4,) [s]; None likewise.
        onboard: Whether x and y were measured forward and left, and rotated into the world frame by the heading.
    """

    time: Array
    value: Array
    grain: Array
    alone: tuple[str, ...] = ()
    late: Array | None = None
    late_error: Array | None = None
    onboard: bool = False

    __repr__ = short_repr

    @property
    def rounding(self) -> Array:
        """Variance added by the rounding of each axis, that of a uniform error, shape (4,) [m^2/s^2, rad^2/s^2]."""
        return np.asarray(self.grain**2 / 12)

    def of(self, axes: tuple[str, ...]) -> bool:
        """Whether the velocity was measured on all of these axes."""
        return bool(self.time.size) and all(np.isfinite(self.value[0, AXES.index(axis)]) for axis in axes)

    def true_time(self, axis: str) -> Array:
        """Times at which the velocity of an axis was valid, on the clock of the poses, shape (V,) [s]."""
        return self.time if self.late is None else self.time - self.late[AXES.index(axis)]

    def between(self, low: float, high: float) -> Velocity:
        """The part between two times, both included [s]."""
        inside = (self.time >= low) & (self.time <= high)
        return replace(self, time=self.time[inside], value=self.value[inside])


@dataclass(frozen=True)
class Segment:
    """An interval without a gap in the commands: from its first command to its last plus the hold [s]."""

    start: float
    end: float


@dataclass(frozen=True)
class Flight:
    """Commands and pose of one flight, ready for estimation. Times are seconds from the start of the common window.

    Attributes:
        path: The log's path as given.
        sha256: Hex digest of the log.
        card: The card that was applied.
        span: Start and end of the requested part, within the common window [s].
        axes: The commanded axes, in the order of `AXES`.
        command_time: Strictly increasing stamps, shape (M,) [s]. A command is held until the next one.
        command: x, y, z, yaw commands in the heading frame after the card's scale, shape (M, 4); 0 where not commanded.
        pose_time: Strictly increasing stamps of the fresh poses, shape (N,) [s].
        position: World x, y, z, shape (N, 3) [m]; for an axis with only a velocity, its integral, for plots and for
            methods that use positions only.
        yaw: Unwrapped heading, shape (N,) [rad].
        segments: Intervals in which the commands are known, in order, not overlapping.
        notes: Every repair, with its count.
        reference: Setpoint of a position controller, held onto the commands' stamps, shape (M, 4), NaN for axes that
            the card does not name and before the first value; None where the card names none.
        clocks: Offset between the clocks of commands and poses; None where both are from one file.
        velocity: Velocity measured by the vehicle itself, where the estimator is to use it.
        findings: Findings from the log and the motion before any fit; empty where no check was run.
        stamp_error: Half the 95 % interval of the remaining offset between commands and poses where stamps were
            corrected by their arrival times [s]; 0 where stamps are as sent.
        shared_error: Half the 95 % interval of an offset that the card or the link states of all stamps, those of other
            flights included [s].
        command_lateness: How long before its stamp a command may have been sent [s]: the period of rows that hold a
            command and a pose; 0 where commands have stamps of their own.
        pose_lateness: How long before its stamp a pose may have been measured [s]: the period of rows that hold the
            latest pose; 0 where poses have stamps of their own.
        command_lead: How long before the vehicle a command in the log may change [s]: half the period of commands
            between which lines were drawn onto the rows; 0 where there are no such lines.
        stamp_step: Step of a clock that most poses, or commands, share a stamp of [s]: none is known to less.
        held: Commanded axes that were taken from `axes`, since the flight only holds them while another moves them.
    """

    path: str
    sha256: str
    card: Card
    span: tuple[float, float]
    axes: tuple[str, ...]
    command_time: Array
    command: Array
    pose_time: Array
    position: Array
    yaw: Array
    segments: tuple[Segment, ...]
    notes: tuple[Note, ...] = ()
    reference: Array | None = None
    clocks: Clocks | None = None
    velocity: Velocity | None = None
    findings: tuple[Finding, ...] = ()
    stamp_error: float = 0.0
    shared_error: float = 0.0
    command_lateness: float = 0.0
    pose_lateness: float = 0.0
    command_lead: float = 0.0
    stamp_step: float = 0.0
    held: tuple[str, ...] = ()

    def __repr__(self) -> str:
        said = (
            f"{self.duration:.1f} s", f"axes {' '.join(self.axes)}", counted(self.command_time.size, "command"),
            counted(self.pose_time.size, "pose"), counted(len(self.notes), "repair"),
            counted(len(self.findings), "finding"),
        )  # fmt: skip
        return f"Flight({self.path!r}, {', '.join(said)})"

    def _repr_html_(self) -> str:
        rows = [(note.code, str(note.count), note.text) for note in self.notes]
        return html_table(repr(self), ("repair", "samples", "what"), rows, self.findings)

    @overload
    def to_frame(self, library: Literal["polars"] = "polars") -> pl.DataFrame: ...
    @overload
    def to_frame(self, library: Literal["pandas"]) -> Any: ...
    def to_frame(self, library: FrameLibrary = "polars") -> Any:
        """The poses as a data frame, with the command in force at each.

        Args:
            library: `polars`, or `pandas`, which must be installed.

        Returns:
            A `DataFrame` with the columns `time` [s], `x`, `y`, `z` [m], `yaw` [rad] and `command_x` to `command_yaw`,
            in the heading frame; NaN where the command is not known.

        Raises:
            ModuleNotFoundError: pandas is requested but not installed.
        """
        held = np.searchsorted(self.command_time, self.pose_time, side="right") - 1
        known = np.any([(self.pose_time >= s.start) & (self.pose_time <= s.end) for s in self.segments], axis=0)
        command = np.where(known[:, None], self.command[np.maximum(held, 0)], np.nan)
        pose = {**dict(zip(AXES, self.position.T, strict=False)), "yaw": self.yaw}
        sent = {f"command_{axis}": command[:, k] for k, axis in enumerate(AXES)}
        return frame({"time": self.pose_time, **pose, **sent}, library)

    def plot(self) -> tuple[Axes, ...]:
        """Draws commands, position and heading over time; shaded grey where the commands are not known.

        Returns:
            The three matplotlib axes, from top to bottom.
        """
        ends = [float(self.pose_time[0]), *(end for s in self.segments for end in (s.start, s.end))]
        holes = list(zip(ends[::2], [*ends[1::2], float(self.pose_time[-1])], strict=True))

        def lines(time: Array, values: Mapping[str, Array], style: str) -> list[Line]:
            looks = {axis: {"color": AXIS_COLOURS[axis], "drawstyle": style, "linewidth": 1.0} for axis in values}
            return [Line(axis, time, series, looks[axis]) for axis, series in values.items()]

        command = {axis: self.command[:, AXES.index(axis)] for axis in self.axes}
        position = dict(zip(AXES, self.position.T, strict=False))
        drawn = (
            ("commands, heading frame", "command", lines(self.command_time, command, "steps-post")),
            ("position, world frame", "position [m]", lines(self.pose_time, position, "default")),
            ("heading", "yaw [rad]", lines(self.pose_time, {"yaw": self.yaw}, "default")),
        )
        panels = [Panel(title, "time [s]", label, parts, holes) for title, label, parts in drawn]
        return line_panels(panels, 1, (8.0, 2.1))

    @property
    def velocity_only(self) -> tuple[str, ...]:
        """Axes with a velocity but no position."""
        return self.velocity.alone if self.velocity else ()

    @property
    def moved(self) -> tuple[str, ...]:
        """The commanded axes with at least one non-zero command."""
        return tuple(a for k, a in enumerate(AXES) if a in self.axes and bool(np.any(self.command[:, k])))

    @property
    def commanded(self) -> dict[str, float]:
        """Largest command of each axis that is moved, along the heading, in the unit of the card."""
        return {axis: float(np.abs(self.command[:, AXES.index(axis)]).max()) for axis in self.moved}

    @property
    def duration(self) -> float:
        """Total length of the segments [s]."""
        return float(np.sum([segment.end - segment.start for segment in self.segments]))

    @property
    def pose_rate(self) -> float:
        """Fresh poses a second within the segments, but for gaps longer than `LONGEST_GAP` [Hz]; 0 if there are none.

        In such a gap the vehicle was lost, or it stood still and its poses repeated.
        """
        if not self.segments:
            return 0.0
        start, end = np.array([(segment.start, segment.end) for segment in self.segments]).T
        before, after = self.pose_time[:-1], self.pose_time[1:]
        k = np.searchsorted(start, before, side="right") - 1
        step = (after - before)[(k >= 0) & (after <= end[k]) & (after - before <= LONGEST_GAP)]
        return step.size / float(step.sum()) if step.size else 0.0


LONGEST_GAP = 1.0
"""Gap in the poses across which nothing is scored or drawn [s]."""

MIN_DURATION = 2.0
"""Shortest flight [s]: the settling time of the filter in the prediction protocol."""

SLOWEST_POSES = 1.0
"""Median sampling period of the poses [s] above which the unit of their clock is taken to be missing."""
