"""Directions of the response to commands: exchanged axes, wrong frames, a yaw that is offset, mirrored or none.

A horizontal command u = u_x + i u_y accelerates the vehicle by A = exp(i k psi) (c_x u_x + c_y u_y + c - B v) in the
world, B diagonal. With the right card k is 1, c_x is real and c_y imaginary. Another k that explains more indicates the
wrong frame, or yaw in another unit; the directions of c_x and c_y indicate a wrong zero of yaw or exchanged axes.
Directions are hardly affected by feedback, and any delay is allowed for, so the test is safe before any fit.

Commands reversed all at once: a pose with z down read as one with z up, or the reverse.

Half a turn about the vehicle's forward axis reverses y, z and yaw and keeps x. So the motion alone cannot distinguish a
pose in NED from commands that are forward, right, down and clockwise; the height can, where the floor is at 0.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import FlightError
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, UNIT_SCALE, Array
from rotorfit.core.log import Log
from rotorfit.core.plain import toml_text
from rotorfit.core.results import Motion
from rotorfit.diagnosis.command_response import SIGNIFICANT, TURNING, Answers, CommandResponse, answers_of, thinned
from rotorfit.diagnosis.motion_checks import LAGS, lagged_command
from rotorfit.diagnosis.recording import Recording
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import column

Complex = npt.NDArray[np.complex128]

BLOCKS = 10
"""Number of stretches of the flight, each of which is left out in turn for the standard errors."""

LEAST_POSES = 100
"""Least number of poses under commands: ten per stretch."""

LEAST_EXPLAINED = 0.3
"""Share of the variance of the horizontal acceleration below which no direction is accepted."""

BETTER = 0.7
"""Largest residual variance of another frame, as a share of that of the card's frame, for it to be reported."""

STRAIGHT = 0.85
"""The same for deviating directions against the right ones, or for another frame that has its directions right. When x
and y are commanded by sine and cosine, as in the paper, a rotated direction is nearly equivalent to a delay: there
standard errors alone prove nothing."""

DEGREE = float(np.pi / 180)

SLIGHT = np.radians(3.0)
"""Standard deviation of yaw as read above which degrees taken for radians matter: below, the wrong heading changes the
gains of x and y by less than 1 - cos(3 degrees), a thousandth."""

SAME_THING = ": with a heading that stays within a few degrees of 0 the commands cannot distinguish the two"
"""Why degrees read as radians and world commands are one finding where the heading hardly turned."""

_LYING = np.radians(15.0)
"""Lean of the body's mean z axis above which a vehicle is not upright: wind that holds it so would be a storm."""

OFF = np.radians(12.0)
"""Deviation of a direction that is reported if it also exceeds `SIGNIFICANT` standard errors. Markers placed by eye are
off by 2 to 5 degrees."""

NEAR = np.radians(30.0)
"""Deviation from a quarter or half turn up to which a direction counts as one."""


@dataclass(frozen=True)
class Directions:
    """Directions of the response to the horizontal commands of a flight, in one frame.

    Attributes:
        turns: k: multiple of the measured yaw by which the command is rotated.
        explained: Share of the variance of the acceleration.
        left: Residual sum of squares [m^2/s^4].
        straight: Residual sum of squares with the directions fixed to the right ones [m^2/s^4].
        angle: Deviation of the effect of `x` and of `y` from the right direction, in (-pi, pi] [rad]; significant ones
            only.
        stderr: Standard error of each [rad].
    """

    turns: float
    explained: float
    left: float
    straight: float
    angle: dict[str, float]
    stderr: dict[str, float]


def frame_findings(recording: Recording) -> Iterator[Finding]:
    """Findings on the frames of one flight; none where its directions are not significant."""
    card, flight, motion = recording.card, recording.flight, recording.motion
    if wrong := _other_axis_up(recording) or _order(recording):
        yield wrong
        return
    moved = [axis for axis in ("x", "y") if np.ptp(flight.command[:, "xy".index(axis)]) > 0]
    if not moved or len(motion.time) < LEAST_POSES or not np.any(motion.acceleration[:, :2]):
        return
    part = thinned(motion, flight.duration)
    own = directions(flight, part, moved, 1)
    others = [directions(flight, part, moved, turns) for turns in _other_turns(card, float(np.std(part.yaw)))]
    if others:
        best = min(others, key=lambda other: other.left)
        if _explains_more(best, own) and best.explained > LEAST_EXPLAINED and best.angle:
            yield _other_frame(card, own, best)
            return
    if _swings_by_itself(recording):
        yield _perhaps_held(motion)
    if own.explained > LEAST_EXPLAINED:
        yield from _turned(card, own, float(np.mean(part.yaw)), float(np.std(part.yaw)))


def _explains_more(other: Directions, own: Directions) -> bool:
    """Whether another frame certainly explains more: much more or, in wind or noise, with its directions right.

    Turned directions make up for a part of a wrong frame, as far as the heading stays near its mean.
    """
    right = other.left > STRAIGHT * other.straight and other.straight < BETTER * own.straight
    return other.left < (STRAIGHT if right else BETTER) * own.left


def other_orders(pose: Mapping[str, Channel]) -> list[dict[str, Channel]]:
    """A quaternion with w last where it was taken first, and the reverse: both orders are in use."""
    names = [f"q{part}" for part in "wxyz"]
    parts = [pose[name] for name in names]
    return [dict(zip(names, parts[first:] + parts[:first], strict=True)) for first in (3, 1)]


def upright_order(log: Log, pose: Mapping[str, Channel]) -> dict[str, Channel] | None:
    """The order of a quaternion's parts in which the vehicle is upright; None if it is so already, or in no order.

    What tilts it averages out over a flight; a vehicle that lies on its side from take-off to landing is none.
    """
    own = _lean(log, pose)
    if not _LYING < own < np.pi - _LYING:  # beyond, the body's z points down
        return None
    best = min(other_orders(pose), key=lambda parts: _lean(log, parts))
    return best if _lean(log, best) < own / 2 else None


def _lean(log: Log, pose: Mapping[str, Channel]) -> float:
    """Angle between the body's mean z axis and the vertical [rad]; a right angle where it has no clear direction."""
    parts = np.array([column(log, pose[f"q{part}"]) for part in "wxyz"])
    w, x, y, z = parts[:, np.linalg.norm(parts, axis=0) > 0]
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w**2 - x**2 - y**2 + z**2])
    mean = np.mean(axis / (w**2 + x**2 + y**2 + z**2), axis=1)
    return float(np.arctan2(np.hypot(*mean[:2]), mean[2])) if np.linalg.norm(mean) > 0.5 else np.pi / 2


def is_held_in_degrees(motion: Motion) -> bool:
    """Whether a heading taken in radians may be one in degrees that was held within a few: it makes no whole turn."""
    return bool(np.ptp(np.unwrap(motion.yaw)) < 2 * np.pi)


def turned_by_yaw(told: Answers) -> bool:
    """Whether the command of yaw turns the vehicle: parts of a quaternion in the wrong order are no heading."""
    return "yaw" in told.of and told.of["yaw"].axis == "yaw"


def strays_from_its_names(told: Answers) -> bool:
    """Whether the command of x or y moves the vehicle along another axis, or backwards."""
    known = [(name, told.of[name]) for name in "xy" if name in told.of]
    return any(answer.axis and (answer.axis != name or answer.sign < 0) for name, answer in known)


def _other_axis_up(recording: Recording) -> Finding | None:
    """Finding for a pose whose vertical axis is another one: its z does not answer the command of z."""
    pose, climbs = recording.card.pose, recording.answers.of.get("z")
    if climbs is None or climbs.axis not in ("x", "y") or not {"x", "y", "z"} <= pose.keys():
        return None
    x, y, z = ("y", "z", "x") if climbs.axis == "x" else ("z", "x", "y")  # cyclic: it stays right-handed
    axes = ", ".join(f"{to} = {toml_text(str(pose[of].source))}" for to, of in zip("xyz", (x, y, z), strict=True))
    parts = [toml_text(str(pose[f"q{of}"].source)) for of in ("w", x, y, z)] if "qw" in pose else []
    turned = f", quaternion = [{', '.join(parts)}]" if parts else ""
    return Finding(
        "axes_exchanged",
        "error",
        f"the command of z moves the vehicle along {climbs.axis} ({climbs.certainty:.0f} standard errors, "
        f"{100 * climbs.explained:.0f} % explained)",
        "no coefficient is the vehicle's: each axis is fitted to the command of another",
        f"if {climbs.axis} of the pose points up, write in [pose] of the card: {axes}{turned}; if only commands are "
        f"wrong, exchange the columns of z and {climbs.axis} in [command]",
    )


def _order(recording: Recording) -> Finding | None:
    """Finding for a quaternion in which the vehicle obeys in another order only.

    That it lies on its side is no proof: a body may be defined so. A flight without a log has a heading alone.
    """
    log, card, flight, own = recording.log, recording.card, recording.flight, recording.answers
    if log is None or "qw" not in card.pose:
        return None
    if "yaw" not in own.of or not np.ptp(flight.command[:, AXES.index("yaw")]):
        upright = upright_order(log, card.pose) if strays_from_its_names(own) else None
        told = "by the card as it is, the vehicle lies on its side throughout the flight and does not follow x and y"
        return _wrong_order(told, upright) if upright else None
    if turned_by_yaw(own):
        return None
    for parts in other_orders(card.pose):
        try:
            other = answers_of(flight_from_log(log, replace(card, pose={**card.pose, **parts})))
        except FlightError:
            continue
        if turned_by_yaw(other):
            evidence = (
                f"commands explain {100 * other.of['yaw'].explained:.0f} % of the turning with {parts['qw'].source} as "
                f"w of the quaternion, but {100 * own.of['yaw'].explained:.0f} % by the card as it is"
            )
            return _wrong_order(evidence, parts)
    return None


def _wrong_order(evidence: str, right: Mapping[str, Channel]) -> Finding:
    names = ", ".join(toml_text(str(right[f"q{part}"].source)) for part in "wxyz")
    return Finding(
        "quaternion_order",
        "error",
        evidence,
        "the heading is none: nothing of yaw is the vehicle's, nor of x and y, whose commands are resolved in the "
        "wrong direction",
        f"name the four in the order w, x, y, z: quaternion = [{names}] in [pose] of the card",
    )


def _other_turns(card: Card, turning: float) -> list[float]:
    """Candidates for k if the card is wrong; empty where the vehicle turned too little."""
    yaw = card.pose.get("yaw")
    heading = card.command_frame == "heading"
    others = ([0.0, -1.0] if heading else [2.0, 0.0]) if turning > TURNING else []
    if heading and SLIGHT < turning <= TURNING:
        others = [-1.0]  # twice as far from the heading as the world's axes, so that it is told with less turning
    angle = yaw.unit or "rad" if yaw and card.frame == "ENU" else None
    units = []
    if angle == "rad" and (SLIGHT < turning <= TURNING or turning * DEGREE > TURNING):
        units = [DEGREE]  # in between, degrees that hardly turned and world commands are indistinguishable
    elif angle == "deg" and turning / DEGREE > TURNING:
        units = [1 / DEGREE]
    return [*others, *units]


def directions(flight: Flight, motion: Motion, moved: list[str], turns: float) -> Directions:
    """Fits the effect of the horizontal commands in the frame rotated by `turns` times the yaw.

    Args:
        flight: The flight that provides the commands.
        motion: Motion of the flight.
        moved: Which of `x` and `y` are commanded.
        turns: k; 1 is the heading frame, 0 the world.
    """
    back = np.exp(-1j * turns * motion.yaw)
    target = (motion.acceleration[:, 0] + 1j * motion.acceleration[:, 1]) * back
    velocity = (motion.velocity[:, 0] + 1j * motion.velocity[:, 1]) * np.exp(1j * motion.yaw) * back
    columns, ones = ["xy".index(axis) for axis in moved], np.ones(len(velocity))
    due = {"x": 1.0 + 0j, "y": 1j}
    left, straight, design = np.inf, np.inf, np.zeros((0, 0))
    for lag in LAGS:
        ahead = lagged_command(flight, motion.time, float(lag))[:, columns] * [due[axis] for axis in moved]
        rest = [velocity.real + 0j, 1j * velocity.imag, ones, 1j * ones]
        free = _real(np.column_stack([ahead, 1j * ahead, *rest]))
        held = _real(np.column_stack([ahead, *rest]))
        if (remains := _left(free, _real(target))) < left:
            left, design = remains, free
        straight = min(straight, _left(held, _real(target)))
    effect, spread = _jackknife(design, _real(target), len(moved))
    told = [i for i in range(len(moved)) if abs(effect[i]) > SIGNIFICANT * spread[i]]
    return Directions(
        turns=turns,
        explained=1 - left / float(np.sum(np.abs(target - target.mean()) ** 2)),
        left=left,
        straight=straight,
        angle={moved[i]: float(np.angle(effect[i])) for i in told},
        stderr={moved[i]: float(spread[i] / abs(effect[i])) for i in told},
    )


def _real(rows: Complex) -> Array:
    """Complex rows as twice as many real ones: the dampings of x and y are real, each along its own axis."""
    return np.concatenate([rows.real, rows.imag])


def _left(design: Array, target: Array) -> float:
    """Residual sum of squares, from the last diagonal element of the triangular factor of both together."""
    return float(_triangle(np.column_stack([design, target]))[-1, -1] ** 2)


def _triangle(rows: Array) -> Array:
    """R of the QR factorisation: all that least squares needs from the rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _jackknife(design: Array, target: Array, count: int) -> tuple[Complex, Array]:
    """Effects of the commands, along (real) and across, and their standard errors by leaving out each stretch in turn.

    Stretches are used because residuals are coloured by wind and by the windows of the derivatives. Each stretch is
    first reduced to its triangular factor.
    """
    rows = np.column_stack([design, target])
    block = np.tile(np.arange(len(rows) // 2) * BLOCKS // (len(rows) // 2), 2)
    triangles = [_triangle(rows[block == b]) for b in range(BLOCKS)]

    def effects(parts: list[Array]) -> Complex:
        stacked = np.concatenate(parts)
        solution = np.linalg.lstsq(stacked[:, :-1], stacked[:, -1], rcond=None)[0]
        return np.asarray(solution[:count] + 1j * solution[count : 2 * count])

    parts = np.array([effects(triangles[:b] + triangles[b + 1 :]) for b in range(BLOCKS)])
    variance: Array = (BLOCKS - 1) / BLOCKS * np.sum(np.abs(parts - parts.mean(axis=0)) ** 2, axis=0)
    return effects(triangles), np.sqrt(np.maximum(variance, 1e-24))


def _other_frame(card: Card, own: Directions, best: Directions) -> Finding:
    """Finding for a wrong frame in the card: another one explains more."""
    told = (
        f"commands explain {100 * best.explained:.0f} % of the horizontal acceleration {{}}, but "
        f"{100 * own.explained:.0f} % by the card as it is"
    )
    effect = (
        "input gain, damping and delay of x and y are not the vehicle's: whenever it turns, commands are resolved in "
        "the wrong direction"
    )
    if best.turns == -1 or (card.command_frame == "world" and best.turns == 0):
        counted = abs(_wrapped(best.angle.get("y", 0.0) - best.angle.get("x", 0.0))) < np.pi / 2
        return Finding(
            "mirrored_pose",
            "error",
            told.format("with yaw counted the other way round"),
            effect,
            'yaw grows clockwise: give it scale = -1 in [pose] of the card (frame = "NED" if z points down, too)'
            if counted
            else "x and y of the pose are exchanged or one of them is turned: make [pose] of the card right-handed",
        )
    if best.turns in (DEGREE, 1 / DEGREE):
        unit = "deg" if best.turns == DEGREE else "rad"
        instead = f', or write frame = "world" in [command]{SAME_THING}' if best.turns == DEGREE else ""
        return Finding(
            "unit_mistake",
            "error",
            told.format(f"with yaw in {unit}"),
            effect,
            f'give yaw in [pose] of the card unit = "{unit}"{instead}',
        )
    world = card.command_frame == "world"
    return Finding(
        "command_frame",
        "error",
        told.format(f"with commands taken in the {'heading' if world else 'world'} frame"),
        effect,
        f'write frame = "{"heading" if world else "world"}" in [command] of the card (now "{card.command_frame}")'
        + ("" if world else f', or give yaw in [pose] unit = "deg"{SAME_THING}'),
    )


def _swings_by_itself(recording: Recording) -> bool:
    """Whether a heading in radians, by default, swings though nothing commands it and the commands are the world's."""
    card, motion = recording.card, recording.motion
    if "yaw" not in card.pose or card.pose["yaw"].unit or card.command_frame == "heading":
        return False
    commanded = np.ptp(recording.flight.command[:, AXES.index("yaw")]) > 0
    return not commanded and float(np.std(motion.yaw)) > TURNING and is_held_in_degrees(motion)


def _perhaps_held(motion: Motion) -> Finding:
    swing = float(np.std(motion.yaw))
    return Finding(
        "unit_mistake",
        "warning",
        f"the heading swings by {np.degrees(swing):.0f} degrees (standard deviation) and nothing commands it; in deg "
        f"it would be held within {swing:.2g}",
        "if it is in deg, x and y are fitted along axes that are not the vehicle's: their coefficients are mixed or "
        "exchanged",
        'look at yaw in the log; if it is in degrees, give yaw in [pose] of the card unit = "deg" and write '
        'frame = "heading" in [command], else unit = "rad"',
    )


def _turned(card: Card, own: Directions, yaw: float, turning: float) -> Iterator[Finding]:
    """The frame is right or indistinguishable; directions may be off by a constant angle."""
    off = {axis: angle for axis, angle in own.angle.items() if abs(angle) > max(OFF, SIGNIFICANT * own.stderr[axis])}
    if not off or own.left > STRAIGHT * own.straight:
        return
    both = len(own.angle) == 2
    apart = abs(_wrapped(own.angle["y"] - own.angle["x"])) if both else 0.0
    told = " and ".join(
        f"{axis} acts {np.degrees(angle):+.0f} +- {np.degrees(own.stderr[axis]):.0f} degrees off its direction"
        for axis, angle in own.angle.items()
    )
    if both and apart > np.pi - NEAR:
        if abs(abs(own.angle["x"]) - np.pi / 2) < NEAR:
            yield _exchanged(told, own.angle["x"] < 0)
        return  # else one sign is reversed: `sign_findings` reports it
    if both and apart > NEAR:
        return
    angle = _mean_angle(own)
    if abs(angle) > np.pi - NEAR:
        return  # both signs, or half a turn: `sign_findings` reports it
    yield _offset(card, own, told, angle, yaw, turning)


def _exchanged(told: str, negative: bool) -> Finding:
    return Finding(
        "axes_exchanged",
        "error",
        f"{told}: a forward command moves the vehicle {'right' if negative else 'left'}, a left command "
        f"{'backwards' if negative else 'forwards'}",
        "no coefficient of x and y is the vehicle's: each is fitted to the command of the other",
        "exchange the columns of x and y in [command] of the card"
        + (", both with scale = -1" if negative else "")
        + ", or those of [pose] if they are the wrong ones",
    )


def _offset(card: Card, own: Directions, told: str, angle: float, yaw: float, turning: float) -> Finding:
    ways = [_yaw_remedy(card, angle) if card.command_frame == "heading" else _world_remedy(angle, yaw)]
    if turning < TURNING and abs(_wrapped(angle + yaw)) < NEAR and card.command_frame == "heading":
        ways.append(
            f'or write frame = "world" in [command]: yaw was held at {np.degrees(yaw):.0f} degrees all the time'
        )
    if abs(abs(angle) - np.pi / 2) < NEAR:
        turned = f", that of {'y' if angle > 0 else 'x'} with its scale turned" if len(own.angle) == 2 else ""
        ways.append(f"or exchange the columns of x and y in [command]{turned}, if only those are wrong")
        ways.append("where others may be wrong, too, `rotorfit info LOG --draft-card NEW.toml --fresh` finds them")
    return Finding(
        "yaw_offset",
        "error" if abs(angle) > np.pi / 4 else "warning",
        f"a command of {told}",
        f"input gains of x and y come out {np.cos(angle):.2f} times what they are, and each axis takes the other's "
        "motion for wind",
        "; ".join(ways),
    )


def _world_remedy(angle: float, yaw: float) -> str:
    """Remedy for commands in the world frame whose directions are off by an angle; yaw does not enter them."""
    if abs(_wrapped(angle - yaw)) < NEAR:
        return (
            f'write frame = "heading" in [command] of the card (now "world"): yaw was near {np.degrees(yaw):.0f} '
            "degrees, and the commands act along the vehicle's own axes there"
        )
    return (
        f"turn the axes of the poses by {np.degrees(angle):+.0f} degrees about z, or those of the commands by as much "
        "the other way: the world of the commands is not that of the poses"
    )


def _yaw_remedy(card: Card, angle: float) -> str:
    """Remedy that rotates yaw by an angle, given the present card."""
    if "yaw" not in card.pose:
        offset = np.degrees(card.heading_offset + (-angle if card.frame == "NED" else angle))
        return (
            f'write heading_offset = {{ value = {offset:.0f}, unit = "deg" }} in [pose] of the card; for flights to '
            f"come, turn the rigid body's axes by {np.degrees(angle):+.0f} degrees about z"
        )
    yaw = card.pose["yaw"]
    raw = angle / UNIT_SCALE[yaw.unit or "rad"] * (-1 if card.frame == "NED" else 1)
    return f"give yaw in [pose] of the card offset = {yaw.offset + raw:.3g} (now {yaw.offset:g})"


def _mean_angle(own: Directions) -> float:
    weight = np.array([1 / own.stderr[axis] ** 2 for axis in own.angle])
    return float(np.angle(np.sum(weight * np.exp(1j * np.array(list(own.angle.values()))))))


def _wrapped(angle: float) -> float:
    return float(np.angle(np.exp(1j * angle)))


OVER = ("y", "z", "yaw")
"""Axes reversed by half a turn about the forward axis."""


def height_sign(flight: Flight) -> int:
    """+1 where the vehicle is above 0 throughout, -1 where it is below, 0 where z is inconclusive."""
    z = flight.position[:, 2]
    return int(np.min(z) > 0) - int(np.max(z) < 0)


def overturned(told: Mapping[str, CommandResponse], height: int) -> tuple[str, ...]:
    """Which of y, z and yaw are reversed, if half a turn about the forward axis explains that; else empty.

    One axis alone is not enough, unless the vehicle flies below the floor.

    Args:
        told: Command to response, as read with the card.
        height: From `height_sign`.
    """
    sure = {name: answer.sign < 0 for name, answer in told.items() if answer.axis == name}
    turned = tuple(name for name in OVER if sure.get(name))
    kept = sure.get("x", False) or any(name in sure and not sure[name] for name in OVER)
    return () if kept or len(turned) < (1 if height < 0 else 2) else turned


def remedy_in_the_pose(name: str, backwards: Mapping[str, bool], turning: float, frame: str) -> str:
    """How the pose, instead of the command, would explain that an axis moves backwards; empty where it would not.

    Args:
        name: Of the axis.
        backwards: Whether each axis whose direction is known moves backwards.
        turning: Largest standard deviation of the heading on the flights [rad].
        frame: That the card gives the pose, `ENU` or `NED`.
    """
    other = {"x": "y", "y": "x"}.get(name, "")
    if backwards.get(other):
        return ", or, as both x and y are backwards, turn yaw by half a turn"
    over = [axis for axis in OVER if axis in backwards]
    if name in over and len(over) > 1 and all(backwards[axis] for axis in over):
        read = "ENU" if frame == "NED" else "NED"
        return f', or, as {" and ".join(over)} are all backwards, read the pose as {read}: frame = "{read}"'
    if other in backwards and turning < TURNING:
        return f"; or the pose is mirrored, which flights that hardly turn do not tell: then {name} of [pose] instead"
    return ""


def sign_findings(recording: Recording) -> Iterator[Finding]:
    """Findings on signs that are reversed, together where half a turn explains them."""
    card = recording.card
    told, height = recording.answers.of, height_sign(recording.flight)
    turned = overturned(told, height) if card.command_frame == "heading" else ()
    backwards = [name for name, answer in told.items() if answer.axis == name and answer.sign < 0]
    known = {name: name in backwards for name, answer in told.items() if answer.axis == name}
    for name in backwards:
        channel = card.command.get(name)
        if channel is None or name in turned:
            continue
        yield Finding(
            "sign_flipped",
            "warning",
            f"the command of {name} moves the vehicle the other way ({told[name].certainty:.0f} standard errors)",
            f"the input gain of {name} comes out negative; delay and damping keep their values",
            f"give {name} in [command] of the card scale = {-channel.scale:g} (now {channel.scale:g})"
            + remedy_in_the_pose(name, known, float(np.std(recording.flight.yaw)), card.frame),
            name,
        )
    if not turned:
        return
    names = " and ".join(filter(None, (", ".join(turned[:-1]), turned[-1])))
    sure = ", ".join(f"{told[name].certainty:.0f}" for name in turned)
    straight = ", that of x the right way" if "x" in told and told["x"].axis == "x" else ""
    where = {1: "; z of the pose is above 0 throughout", -1: "; z of the pose is below 0 throughout", 0: ""}[height]
    other = "ENU" if card.frame == "NED" else "NED"
    ways = [
        f'is the pose {other}? Write frame = "{other}" at the top of the card (now "{card.frame}")',
        f"are the commands forward, right, down, clockwise? Turn the scale of {names} in [command]",
    ]
    yield Finding(
        "axes_turned",
        "warning",
        f"the command of {names} moves the vehicle the other way ({sure} standard errors){straight}{where}",
        f"the input gain of {names} comes out negative; delay and damping keep their values",
        "; or ".join(ways if height <= 0 else ways[::-1]),
    )
