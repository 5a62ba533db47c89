"""Checks of the poses of a flight: jumps of the markers, axes that stand still, and implausible units."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.display import counted
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, POSE_UNITS, UNIT_SCALE, Array, Mask
from rotorfit.core.frozen import SUFFERING
from rotorfit.core.results import Motion
from rotorfit.diagnosis.globe import is_latitude, is_longitude, metres_per_degree, scale_and_offset
from rotorfit.diagnosis.recording import Recording

LEAP_SIGMAS = 10.0
"""Robust standard deviations from the neighbouring motion above which a step may be a jump."""

LEAP_FLOORS = (0.02, 20.0 * 0.15), (0.05, 100.0 * 0.15)
"""Deviation of a step from the neighbouring motion that is no jump, for position [m, m/s] and yaw [rad, rad/s]: a
floor, plus so much per second of the step. The latter is the speed that 20 m/s^2, or 100 rad/s^2, give in the 0.15 s
by which the neighbours are apart."""

NEIGHBOURS = 9
"""Number of steps on either side whose median speed is the neighbouring motion."""

NEAREST = 2
"""Number of steps on either side between whose speeds that of a step lies, unless it jumps."""

PEAKS = (0.02, 60.0), (0.08, 30.0)
"""Deviation of a step from the speeds of the nearest steps that is no jump, for position [m, m/s^2] and yaw
[rad, rad/s^2]: a floor, and what that acceleration gives within the step. Only the drag of its rotors turns a
vehicle."""

RETURN = 1.0
"""Time within which a jump that is undone has returned [s]."""

STILL = 5.0
"""Least time for which a coordinate repeats exactly, though it is commanded, to be frozen [s]: heights in steps of a
centimetre repeat for less while the vehicle climbs."""

FROZEN_COMMAND = 0.5
"""Least RMS of the command meanwhile, as a share of that of the whole flight."""

FASTEST, HARDEST = 30.0, 25.0
"""RMS speed [m/s] and acceleration [m/s^2] over a flight that no multirotor sustains."""

FASTEST_TURN = 6.0
"""RMS turn rate over a flight that no multirotor sustains [rad/s]: commercial ones are limited to 1.7 to 5."""

SMALLEST = 0.02
"""Largest extent in x, y and z [m] that no commanded flight stays within: a hover drifts more."""

FEW_DEGREES = 0.1
"""Largest extent of a longitude and a latitude as numbers that are degrees: 11 km."""

LOST, SPOILT = 0.01, 0.05
"""Share of poses at the origin, between others, from which on it is told, and from which on nothing is left to fit."""

AWAY = 0.1
"""Distance of the poses around from the origin [m]: a vehicle that starts there may be exactly there."""


def pose_findings(recording: Recording) -> Iterator[Finding]:
    """Findings on the poses of one flight."""
    flight, motion = recording.flight, recording.motion
    frozen = dict(_frozen_axes(flight))
    thawed = [at for span in frozen.values() for at in span]
    yield from _leaps("position", flight.pose_time, flight.position, LEAP_FLOORS[0], PEAKS[0], thawed)
    yield from _leaps("yaw", flight.pose_time, flight.yaw[:, None], LEAP_FLOORS[1], PEAKS[1], thawed)
    yield from _frozen(flight, frozen)
    yield from _zeros_between(flight)
    globe = list(_degrees_of_the_globe(flight))
    yield from globe
    yield from [] if globe else _unit_of_position(flight, motion)
    yield from [] if globe else _unit_of_one_axis(recording)
    yield from _unit_of_yaw(motion)


def leaps(time: Array, value: Array, floor: tuple[float, float], peak: tuple[float, float]) -> tuple[Array, Array]:
    """Steps that the neighbouring motion does not explain: far from its median, or less far and from all nearest steps.

    Args:
        time: Stamps, shape (N,) [s].
        value: Position or yaw, shape (N, K).
        floor: Least size of a jump against the median motion, and its increase per second of the step.
        peak: Least size of a jump against the nearest steps, and the acceleration that is no jump.

    Returns:
        When each jump ends, shape (J,) [s], and its deviation from the motion, shape (J, K).
    """
    if len(time) < 4 * NEIGHBOURS:
        return np.zeros(0), np.zeros((0, value.shape[1]))
    step = np.diff(time)
    by = np.diff(value, axis=0)
    speed = by / step[:, None]
    padded = np.pad(speed, ((NEIGHBOURS, NEIGHBOURS), (0, 0)), mode="edge")
    beyond = by - step[:, None] * _running_median(padded, 2 * NEIGHBOURS + 1)
    size = np.linalg.norm(beyond, axis=1)
    noise = LEAP_SIGMAS * 1.4826 * float(np.median(size))
    leap: Mask = size > noise + floor[0] + floor[1] * step
    nearest = np.linalg.norm(_beyond_nearest(by, speed, step), axis=1)
    leap |= np.minimum(size, nearest) > noise + peak[0] + 0.5 * peak[1] * step**2
    return time[1:][leap], beyond[leap]


def _beyond_nearest(by: Array, speed: Array, step: Array) -> Array:
    """By how much each step leaves the range of the speeds of the nearest steps, shape (N, K).

    A step whose stamps are too near to each other counts as one of usual length.
    """
    padded = np.pad(speed, ((NEAREST, NEAREST), (0, 0)), mode="edge")
    near = [padded[i : i + len(speed)] for i in range(2 * NEAREST + 1) if i != NEAREST]
    low, high = np.min(near, axis=0), np.max(near, axis=0)
    short, long = step[:, None], np.maximum(step, np.median(step))[:, None]
    return np.asarray(by - np.clip(by, np.minimum(low * short, low * long), np.maximum(high * short, high * long)))


def _running_median(values: Array, width: int) -> Array:
    """Running medians over an odd number of rows, column by column: shape (N - width + 1, K) from (N, K)."""
    out = np.empty((values.shape[0] - width + 1, values.shape[1]))
    _fill_medians(np.ascontiguousarray(values), np.empty(width), out)
    return out


@kernel()
def _fill_medians(values: Array, sorted_: Array, out: Array) -> None:
    """Fills the medians; `sorted_` (width,) is work space. A call of a sort would take a second to compile."""
    for k in range(values.shape[1]):
        for i in range(out.shape[0]):
            for n in range(sorted_.size):
                new, at = values[i + n, k], n
                while at > 0 and sorted_[at - 1] > new:
                    sorted_[at] = sorted_[at - 1]
                    at -= 1
                sorted_[at] = new
            out[i, k] = sorted_[sorted_.size // 2]


def position_unit(motion: Motion) -> tuple[str, float] | None:
    """`cm` or `mm`, whichever gives a speed nearer to 1 m/s, and that RMS speed [m/s]; None if metres are plausible.

    Args:
        motion: Motion of the flight with positions taken in metres.
    """
    speed, acceleration = _pace(motion)
    if speed <= FASTEST and acceleration <= HARDEST:
        return None
    unit = min(("cm", "mm"), key=lambda unit: abs(np.log(speed * UNIT_SCALE[unit])))
    return unit, speed * UNIT_SCALE[unit]


def degrees_turned(motion: Motion) -> float | None:
    """RMS turn rate of a heading that must be in degrees [deg/s]; None if radians are plausible.

    Args:
        motion: Motion of the flight with the heading taken in radians.
    """
    rate = float(np.sqrt(np.mean(motion.velocity[:, 3] ** 2))) if len(motion.time) else 0.0
    return rate if rate > FASTEST_TURN else None


def _pace(motion: Motion) -> tuple[float, float]:
    """RMS speed [m/s] and acceleration [m/s^2]; 0 for an empty motion."""
    if not len(motion.time):
        return 0.0, 0.0
    speed, acceleration = (
        float(np.sqrt(np.mean(np.sum(rows[:, :3] ** 2, axis=1)))) for rows in (motion.velocity, motion.acceleration)
    )
    return speed, acceleration


def _frozen_axes(flight: Flight) -> Iterator[tuple[str, tuple[float, float]]]:
    """Each coordinate that repeats exactly for `STILL` while it is commanded, and its longest such stretch [s]."""
    moved_by = [flight.command[:, [0, 1]], flight.command[:, [0, 1]], flight.command[:, [2]], flight.command[:, [3]]]
    for axis, values, command in zip(AXES, [*flight.position.T, flight.yaw], moved_by, strict=True):
        channel = flight.card.pose.get("qw" if axis == "yaw" and "yaw" not in flight.card.pose else axis)
        if channel is None or not isinstance(channel.source, str):  # not measured
            continue
        moves = np.flatnonzero(np.diff(values)) + 1
        starts, ends = np.r_[0, moves], np.r_[moves, len(values)] - 1
        longest = int(np.argmax(flight.pose_time[ends] - flight.pose_time[starts]))
        start, end = (float(flight.pose_time[each[longest]]) for each in (starts, ends))
        during = command[(flight.command_time >= start) & (flight.command_time <= end)]
        if end - start < STILL or not np.any(np.ptp(during, axis=0) if len(during) else 0.0):
            continue
        if np.mean(during**2) >= FROZEN_COMMAND**2 * np.mean(command**2):
            yield axis, (start, end)


def _frozen(flight: Flight, frozen: Mapping[str, tuple[float, float]]) -> Iterator[Finding]:
    first, last = flight.pose_time[[0, -1]]
    coordinates = dict(zip(AXES, [*flight.position.T, flight.yaw], strict=True))
    for axis, (start, end) in frozen.items():
        during = (flight.pose_time >= start) & (flight.pose_time <= end)
        value = coordinates[axis][during][0]
        moving = ", ".join(other for other, values in coordinates.items() if np.ptp(values[during]) > 0)
        whole = start <= first and end >= last
        where = "throughout" if whole else f"from {start:.1f} s {'to the end' if end >= last else f'to {end:.1f} s'}"
        cause = "a sensor, an estimator or a bridge that repeats its last value"
        span = f":{start:.1f}" if start - first >= last - end else f"{end:.1f}:"
        suffering = [other for other in SUFFERING[axis][1:] if other in flight.axes]
        others = ",".join(other for other in flight.axes if other not in (axis, *suffering))
        yield Finding(
            "pose_frozen",
            "warning",
            f"{axis} of the pose is frozen {where}: exactly {value:.4g} {POSE_UNITS[axis]} for {end - start:.1f} s, "
            f"while it is commanded{f' and the pose changes in {moving}' if moving else ''}",
            f"{axis} shows no response to its commands there: "
            + ("none of its coefficients can be identified" if whole else "its coefficients are wrong or unknown")
            + (f"; those of {' and '.join(suffering)} are wrong where the vehicle turns" if suffering else ""),
            f"check that the card names the right column for {axis} of [pose]; if so, look for {cause}"
            + (f"; fit the other axes by --axes {others}" if others else "")
            if whole
            else f"fit without that stretch, --span {span}; look for {cause}",
            axis,
        )


def _zeros_between(flight: Flight) -> Iterator[Finding]:
    """Poses that are exactly 0 in x, y and z while the vehicle is elsewhere: filled blanks, or a lost vehicle."""
    zero = np.all(flight.position == 0.0, axis=1)
    known, at = np.flatnonzero(~zero), np.flatnonzero(zero)
    if not known.size or not at.size:
        return
    nearest = flight.position[known[np.maximum(np.searchsorted(known, at) - 1, 0)]]
    away = np.linalg.norm(nearest, axis=1)
    count, share = int(np.sum(away > AWAY)), float(np.sum(away > AWAY)) / zero.size
    if share < LOST:
        return
    yield Finding(
        "zeros_between_poses",
        "error" if share > SPOILT else "warning",
        f"{count} of {zero.size} poses are exactly 0 in x, y and z, between others up to {away.max():.3g} m away: "
        "blank cells filled with 0, or rows without the vehicle",
        "they count as leaps to the origin and back, which no command caused: what is fitted to them means nothing",
        "leave cells without a pose blank, and rows without the vehicle out; then read the log again",
    )


def _leaps(
    what: str,
    time: Array,
    value: Array,
    floor: tuple[float, float],
    peak: tuple[float, float],
    thawed: Sequence[float],
) -> Iterator[Finding]:
    new = np.append(True, np.any(np.diff(value, axis=0) != 0, axis=1))  # a value may come less often than its rows
    time, value = time[new], value[new]
    when, by = leaps(time, value, floor, peak)
    kept = [one > 0 and time[max(one - 1, 0)] not in thawed for one in np.searchsorted(time, when)]
    when, by = when[kept], by[kept]  # a coordinate that was frozen catches up: told as such
    if not len(when):
        return
    undone = _undone(when, by)
    back, stay = len(undone) // 2, [float(at) for i, at in enumerate(when) if i not in undone]
    largest = float(np.max(np.linalg.norm(by, axis=1)))
    size = f"{100 * largest:.3g} cm" if what == "position" else f"{np.degrees(largest):.3g} degrees"
    concerned = "all coefficients" if what == "yaw" else "input gain and damping of x, y and z"
    yield Finding(
        "pose_jumps",
        "warning",
        f"the {what} jumps {counted(len(when), 'time')} against its neighbouring motion, by up to {size}, the first "
        f"time at {when[0]:.2f} s; {back} come back within {RETURN:g} s, {len(stay)} stay",
        f"jumps are fitted as motion that no command caused: {concerned} come out with wider intervals, and with few "
        "data biased",
        "; ".join(([REMEDY_BACK] if back else []) + [_apart(at) for at in stay[:1]]),
        "yaw" if what == "yaw" else None,
    )


REMEDY_BACK = (
    "check the rigid body's markers for swaps and reflections; fit with --method robust, which leaves poses out that "
    "come back, or leave the stretch out by --span"
)


def _apart(at: float) -> str:
    """What to do about a jump that stays, the first of them at a time [s]."""
    return (
        "a jump that stays is an estimator or a frame that was reset, or markers that were exchanged: fit what was "
        f"flown before and after it apart, --span :{at:.1f} and --span {at:.1f}:"
    )


def _undone(when: Array, by: Array) -> list[int]:
    """Jumps that are soon followed by one in the opposite direction of about the same size, and those."""
    used: list[int] = []
    for i in range(len(when)):
        for j in range(i + 1, len(when)):
            if i in used or j in used or when[j] - when[i] > RETURN:
                continue
            if np.linalg.norm(by[i] + by[j]) < 0.3 * np.linalg.norm(by[i]):
                used += [i, j]
    return used


def _unit_of_yaw(motion: Motion) -> Iterator[Finding]:
    rate = degrees_turned(motion)
    if rate is not None:
        yield Finding(
            "unit_mistake",
            "error",
            f"the vehicle turns with {rate:.3g} rad/s (RMS); no multirotor keeps more than {FASTEST_TURN:g} rad/s",
            "input gain of yaw is too large by the ratio of the units, and x and y are resolved in a wrong heading",
            'give yaw in [pose] of the card unit = "deg"',
            "yaw",
        )


def _degrees_of_the_globe(flight: Flight) -> Iterator[Finding]:
    """A position by longitude and latitude that the card takes for metres."""
    names = {axis: one.source for axis, one in flight.card.pose.items() if axis in "xy" and one.scale == 1}
    axes = [axis for is_named in (is_longitude, is_latitude) for axis, name in names.items() if is_named(name)]
    east = "y" if flight.card.frame == "NED" else "x"
    place = flight.position[:, [int(axis != east) for axis in axes]]
    if set(axes) != {"x", "y"} or not is_longitude(names[axes[0]]) or np.max(np.ptp(place, axis=0)) > FEW_DEGREES:
        return
    lines = []
    for axis, metres, first in zip(axes, metres_per_degree(float(place[0, 1])), place[0].tolist(), strict=True):
        scale, offset = scale_and_offset(metres, first)
        lines.append(f'{axis} = {{ from = "{names[axis]}", scale = {scale:.9g}, offset = {offset:.9g} }}')
    yield Finding(
        "unit_mistake",
        "error",
        f"{' and '.join(str(names[axis]) for axis in axes)} are taken for metres, and stay within "
        f"{np.max(np.ptp(place, axis=0)):.2g}: they are degrees of longitude and latitude",
        "x and y seem to stand still: nothing is known of them, or their input gains are too small by 100,000",
        f"write {' and '.join(lines)} in [pose] of the card: metres from where the flight begins",
    )


def _line_with_unit(flight: Flight, unit: tuple[str, float] | None) -> str:
    """The line of x in a card, with a unit for it."""
    source = flight.card.pose["x"].source if "x" in flight.card.pose else "..."
    return f'x = {{ from = "{source}", unit = "{unit[0] if unit else "cm"}" }}'


def _unit_of_one_axis(recording: Recording) -> Iterator[Finding]:
    """An axis that clearly follows its command, but within a few millimetres, beside axes that move."""
    travel = np.ptp(recording.flight.position, axis=0)
    for axis, answer in recording.answers.of.items():
        within = float(travel[2] if axis == "z" else np.max(travel[:2]))
        if axis != "yaw" and answer.axis == axis and 0 < within < SMALLEST < np.max(travel):
            yield Finding(
                "unit_mistake",
                "warning",
                f"{axis} follows its command ({answer.certainty:.0f} standard errors), but stays within "
                f"{1e3 * within:.2g} mm, while others move by {np.max(travel):.2g} m",
                f"the input gain of {axis} is too small by the ratio of the units; damping and delay keep their values",
                f"check the unit of {axis} of [pose] in the card: metres read as cm or mm?",
                axis,
            )


def _unit_of_position(flight: Flight, motion: Motion) -> Iterator[Finding]:
    if not len(motion.time):
        return
    speed, acceleration = _pace(motion)
    travel = float(np.max(np.ptp(flight.position, axis=0)))
    commanded = any(np.any(flight.command[:, AXES.index(axis)]) for axis in flight.axes if axis != "yaw")
    told = f"the vehicle moves with {speed:.3g} m/s and {acceleration:.3g} m/s^2 (RMS) within {travel:.3g} m"
    if speed > FASTEST or acceleration > HARDEST:
        yield Finding(
            "unit_mistake",
            "error",
            f"{told}; no multirotor keeps more than {FASTEST:g} m/s or {HARDEST:g} m/s^2",
            "input gains of x, y and z are too large by the ratio of the units; damping and delay keep their values",
            f"write {_line_with_unit(flight, position_unit(motion))} in [pose] of the card, and y and z if theirs is "
            f'the same: "cm" makes the travel {travel / 100:.3g} m, "mm" {travel / 1000:.3g} m; check the time, too',
        )
    elif commanded and 0 < travel < SMALLEST:
        yield Finding(
            "unit_mistake",
            "warning",
            f"{told}, though it is commanded; no flight stays within {100 * SMALLEST:g} cm",
            "input gains of x, y and z are too small by the ratio of the units, while damping and delay keep their "
            "values; or nothing flew, and there is nothing to fit",
            "check the unit of x, y and z of [pose] in the card (metres read as cm or mm?), and that the vehicle flew",
        )
