"""Flight: what a vehicle was told and where it was, on one clock, in SI units, with every repair as a note."""

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
    """A repair or a remark on a flight.

    Attributes:
        code: Short stable name, such as `stale_poses`.
        text: One sentence with the count in it.
        count: How many samples it concerns.
    """

    code: str
    text: str
    count: int


ANSWER = 0.2
"""Where the answer to a command is put after it [s], if commands are all that tells the offset: inside of the range of
delays that the likelihood searches, whatever the delay is."""

AGREES = 0.002
"""Offset that is none, whatever its interval says [s]."""


@dataclass(frozen=True)
class Clocks:
    """How the clock of the commands stands to that of the poses, of a flight in several files.

    Attributes:
        source: What told it: `onboard` (velocity or heading by the vehicle's own sensors), `command` (the answer to the
            commands) or `none`.
        offset: Added to a command's stamp at `middle`, it gives the stamp by the clock of the poses [s].
        half_width: Of its 95 % interval [s]; 0 where only the answer to the commands told it, roughly.
        drift: Growth of the offset a second; 0 likewise.
        drift_half_width: Of its 95 % interval.
        middle: Middle of the commands, counted from the first [s].
        moved: Whether the stamps of the commands were moved.
        stated: Why the clocks are taken to be one, as a clause; empty where each file has its own.
        explained: Witness to the share of its variance that the motion of the poses explains.
        later: Onboard sensor that was left out, because it is late against the others, to by how much [s].
        refused: Why the vehicle's own sensors did not tell the offset, as a clause; empty where they did, or there are
            none.
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
        """Whether the offset that was taken out holds the delay, too."""
        return self.moved and self.source == "command"

    @property
    def with_delay(self) -> float:
        """Offset and delay together, where only the answer to the commands told them: what was measured [s]."""
        return self.offset + ANSWER

    @property
    def differs(self) -> bool:
        """Whether the clocks were seen to differ beyond their intervals."""
        grown = abs(self.drift) * 2 * self.middle
        return self.source != "none" and (
            abs(self.offset) > max(self.half_width, AGREES)
            or (abs(self.drift) > self.drift_half_width and grown > AGREES)
        )


@dataclass(frozen=True)
class Velocity:
    """What the vehicle itself measured of its velocity, on its own clock.

    Attributes:
        time: Strictly increasing stamps, shape (V,) [s].
        value: World x, y, z and the rate of yaw, shape (V, 4), NaN for axes without [m/s, rad/s].
        grain: To what each is rounded where that is coarse, else 0, shape (4,) [m/s, rad/s].
        alone: Axes of which there is no position: only this.
        late: How late each is against the pose, shape (4,) [s]; None as long as that has not been looked at.
        late_error: Half the 95 % interval of that, shape (4,) [s]; None likewise.
        onboard: Whether x and y were measured forward and left, and turned into the world by the heading.
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
        """Variance that the rounding adds to each, shape (4,): that of a uniform error [m^2/s^2, rad^2/s^2]."""
        return np.asarray(self.grain**2 / 12)

    def of(self, axes: tuple[str, ...]) -> bool:
        """Whether it was measured on all of these axes."""
        return bool(self.time.size) and all(np.isfinite(self.value[0, AXES.index(axis)]) for axis in axes)

    def true_time(self, axis: str) -> Array:
        """When the velocity of an axis was what it says, on the clock of the poses, shape (V,) [s]."""
        return self.time if self.late is None else self.time - self.late[AXES.index(axis)]

    def between(self, low: float, high: float) -> Velocity:
        """What lies between two times [s]."""
        inside = (self.time >= low) & (self.time <= high)
        return replace(self, time=self.time[inside], value=self.value[inside])


@dataclass(frozen=True)
class Segment:
    """A stretch in which the commands are known: from its first command to its last plus its hold [s]."""

    start: float
    end: float


@dataclass(frozen=True)
class Flight:
    """Commands and pose of one flight, ready for estimation. Times are seconds from the start of the common window.

    Attributes:
        path: The log's path as given.
        sha256: Hex digest of the log.
        card: The card that was applied.
        span: Start and end that were asked for, within the common window [s].
        axes: The commanded axes, in the order of `AXES`.
        command_time: Strictly increasing stamps, shape (M,) [s]. A command holds until the next one.
        command: x, y, z, yaw commands in the heading frame after the card's scale, shape (M, 4); 0 where not commanded.
        pose_time: Strictly increasing stamps of the fresh poses, shape (N,) [s].
        position: World x, y, z, shape (N, 3) [m]; of an axis that has only a velocity, that velocity summed up, for
            drawings and for the methods that look at nothing else.
        yaw: Unwrapped heading, shape (N,) [rad].
        segments: Where the commands are known, in order, not overlapping.
        notes: Every repair, with its count.
        reference: What a position controller was told, held onto the commands' stamps, shape (M, 4), NaN for axes that
            the card does not name and before the first value; None where it names none.
        clocks: How the clock of the commands stood to that of the poses; None where they are from one file.
        velocity: What the vehicle itself measured of its velocity, where the estimator is to use it.
        findings: What its log and the motion tell before any fit; empty where nobody has looked.
        stamp_error: Half of the 95 % interval of what stamps corrected by their arrivals leave unknown between commands
            and poses [s]; 0 where they are as the senders gave them.
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
        """The poses as a data frame, with the command that was held at each.

        Args:
            library: `polars`, or `pandas`, which must be installed.

        Returns:
            A `DataFrame` of the columns `time` [s], `x`, `y`, `z` [m], `yaw` [rad] and `command_x` to `command_yaw`,
            in the heading frame; NaN where the command is not known.

        Raises:
            ModuleNotFoundError: pandas is asked for and not installed.
        """
        held = np.searchsorted(self.command_time, self.pose_time, side="right") - 1
        known = np.any([(self.pose_time >= s.start) & (self.pose_time <= s.end) for s in self.segments], axis=0)
        command = np.where(known[:, None], self.command[np.maximum(held, 0)], np.nan)
        pose = {**dict(zip(AXES, self.position.T, strict=False)), "yaw": self.yaw}
        sent = {f"command_{axis}": command[:, k] for k, axis in enumerate(AXES)}
        return frame({"time": self.pose_time, **pose, **sent}, library)

    def plot(self) -> tuple[Axes, ...]:
        """Draws commands, position and heading over time; grey where the commands are not known.

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
        """Axes of which there is a velocity and no position."""
        return self.velocity.alone if self.velocity else ()

    @property
    def moved(self) -> tuple[str, ...]:
        """The axes that the flight commands with anything but zero."""
        return tuple(a for k, a in enumerate(AXES) if a in self.axes and bool(np.any(self.command[:, k])))

    @property
    def duration(self) -> float:
        """Length of the segments together [s]."""
        return float(np.sum([segment.end - segment.start for segment in self.segments]))


LONGEST_GAP = 1.0
"""Hole in the poses across which nothing is scored or drawn [s]."""

MIN_DURATION = 2.0
"""Shortest flight [s]: what the prediction protocol gives to the filter before it scores."""

SLOWEST_POSES = 1.0
"""Median period of the poses [s] beyond which their clock is taken to lack its unit."""
