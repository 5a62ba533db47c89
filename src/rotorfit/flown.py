"""Flown: how a flight ended and what it left; Status: how it is going."""

from dataclasses import dataclass
from pathlib import Path

from rotorfit.plan import Four


@dataclass(frozen=True)
class Ending:
    """Why a flight ended: `completed`, `operator`, `disk`, `error`, or a code of the guard; and a text."""

    reason: str
    text: str


@dataclass(frozen=True)
class Jitter:
    """By how much commands left later than they were due: median, 99th percentile, largest [s]."""

    p50: float
    p99: float
    max: float


@dataclass(frozen=True)
class Status:
    """How a flight is going.

    Attributes:
        phase: `take-off`, `approach` or `plan`.
        time: Since the phase began [s].
        duration: Of the plan [s].
        pose: x, y, z [m], yaw [rad]; None before the first.
        room: Distance to the fence, braking distance included [m].
        battery: 0 to 1; None where nobody says.
    """

    phase: str
    time: float
    duration: float
    pose: Four | None
    room: float
    battery: float | None


@dataclass(frozen=True)
class Flown:
    """A flight that has ended.

    Attributes:
        reason: `completed`, or what ended it, see `Ending`.
        text: The same for people.
        duration: Of the plan, as far as it was flown [s].
        jitter: Of the commands, by the clock of the link; says nothing where that clock is simulated.
        late: Commands that came more than three periods late.
        commands: Sent.
        poses: Received.
        outliers: Poses that could not be true.
        landed: Whether a landing was asked for and the link took it.
        path: Of the recording.
        notes: What a user should know of it.
    """

    reason: str
    text: str
    duration: float
    jitter: Jitter
    late: int
    commands: int
    poses: int
    outliers: int
    landed: bool
    path: Path
    notes: tuple[str, ...] = ()
