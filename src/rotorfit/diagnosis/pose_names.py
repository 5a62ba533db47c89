"""Poses in a table by the names of its columns: what is named alike was measured together."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile

from rotorfit.core.log import Table
from rotorfit.flights.columns import clocks, name_without_unit, series_of

_WHERE = (
    "(?:(?:pose|transform|position|pos|translation|p|mocap|mc|vicon|optitrack|opt|lighthouse|state|estimate|odom|drone|"
    "marker|aruco|tag|apriltag|cam|camera|webcam|"
    "body|stabilizer|kalman_state(?!_p))_?)*"  # kalman.statePX is a velocity
)

_AT = f"{_WHERE}(?:position|pose|pos|p)_?"

_POS = "_?(?:pos|position)"

_OF_A_TOPIC = "(?!.*(?:cmd|command|setpoint|target|goal|desired|ref))(?:.*_)?"
"""Before the fields of a message: its topic, or `field` as rostopic echo -p has it."""

_PLACES: tuple[Mapping[str, str], ...] = (
    {
        axis: f"{_WHERE}({axis})|({axis})_?(?:pos|position|opt|mocap|est|u)|"
        f"{_OF_A_TOPIC}(?:pose_position|transform_translation)_({axis})"
        for axis in "xyz"
    },
    {axis: f"{_WHERE}(?:position|pos|p)_({i})" for i, axis in enumerate("xyz")},
    {
        "x": f"{_AT}(e)|(e){_POS}|{_WHERE}(east)",
        "y": f"{_AT}(n)|(n){_POS}|{_WHERE}(north)",
        "z": f"{_AT}(u)|(u){_POS}|{_WHERE}(up|alt|altitude)",
    },
    {
        "x": f"{_AT}(n)|(n){_POS}|{_WHERE}(north)",
        "y": f"{_AT}(e)|(e){_POS}|{_WHERE}(east)",
        "z": f"{_AT}(d)|(d){_POS}|{_WHERE}(down)",
    },
)

_FIX = f"(?:(?:gps|gnss|fix|global(?:_pos(?:ition)?)?)_?)*{_WHERE}"

_ON_THE_GLOBE: Mapping[str, str] = {
    "x": f"{_FIX}(lon|lng|long|longitude)",
    "y": f"{_FIX}(lat|latitude)",
    "z": f"{_FIX}(up|alt|altitude|height)",
}

_QUATERNION = "(?:orientation|rotation|quaternion|quat|q)_?"

_HEADINGS: tuple[Mapping[str, str], ...] = (
    {
        f"q{part}": f"{_WHERE}{_QUATERNION}({part})|{_OF_A_TOPIC}(?:pose_orientation|transform_rotation)_({part})"
        for part in "wxyz"
    },
    {f"q{part}": f"{_WHERE}{_QUATERNION}({i})" for i, part in enumerate("wxyz")},
    {f"q{part}": f"{_WHERE}{_QUATERNION}({i})" for i, part in enumerate("wxyz", 1)},
    *(
        {"yaw": f"{_WHERE}({word})|({word})_?(?:pos|opt|mocap|est)"}
        for word in ("yaw", "psi", "heading", "hdg", "compass")
    ),
)


_BODY_PART = re.compile(r"(.*)\.(position|quaternion|rotation)\.([wxyz])")


@dataclass(frozen=True)
class Family:
    """Columns of a table whose names differ in the axis alone.

    Attributes:
        stem: Their plain name with the axis left out.
        names: Quantity to column.
    """

    stem: tuple[str, str]
    names: Mapping[str, str]


@dataclass(frozen=True)
class NamedPose:
    """A pose by the names of its columns.

    Attributes:
        names: Quantity to column.
        strays: Which of x, y, z have a name of another kind, and may be of another sensor.
        unused: Names that may be a position or a heading, too; the first of each family.
    """

    names: Mapping[str, str]
    strays: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()


def completeness(pose: NamedPose) -> int:
    """How many of x, y, z and a heading a pose has."""
    return len(pose.names.keys() & {"x", "y", "z"}) + bool(pose.names.keys() & {"yaw", "qw"})


def bodies_named(table: Table) -> list[NamedPose]:
    """Rigid bodies in an export of motion capture; the fullest, then the shortest names first.

    Elsewhere such names may be anything. A rotation without w is no quaternion.
    """
    bodies: dict[str, dict[str, dict[str, str]]] = {}
    for name in table.columns:
        if part := _BODY_PART.fullmatch(name):
            body, kind, axis = part.groups()
            bodies.setdefault(body, {}).setdefault(kind, {})[axis] = name
    found = []
    for body in sorted(bodies, key=len):
        kinds = bodies[body]
        turned = next((kinds[kind] for kind in ("rotation", "quaternion") if "w" in kinds.get(kind, {})), {})
        found.append(NamedPose(kinds.get("position", {}) | {f"q{part}": name for part, name in turned.items()}))
    return sorted(found, key=completeness, reverse=True)


def poses_named(table: Table) -> list[NamedPose]:
    """Poses in a table, each from the family with the most of x, y and z; the likeliest first.

    North and east without down are one pose, with z up.
    """
    places, headings = _families(table, _PLACES), headings_named(table)
    full = [place for place in places if len(place.names) == len(places[0].names)]
    fullest = {frozenset(place.names.values()): place for place in reversed(full)}.values()
    return [_pose(place, places, headings) for place in reversed(fullest)]


def fixes_named(table: Table) -> list[NamedPose]:
    """Poses in a table by longitude and latitude, with a height; the likeliest first."""
    places = [place for place in _families(table, [_ON_THE_GLOBE]) if {"x", "y"} <= place.names.keys()]
    heights = _families(table, _PLACES)
    return [_pose(place, [*places, *heights], headings_named(table)) for place in places]


def named_alike(table: Table, patterns: Mapping[str, str]) -> dict[str, str]:
    """Quantity to column, of the fullest family; what that lacks is of the next one that has it.

    Args:
        table: The table.
        patterns: Quantity to the pattern of its plain name, with the axis in a group of its own.
    """
    return _filled(_families(table, [patterns]))


def _filled(families: Sequence[Family]) -> dict[str, str]:
    names: dict[str, str] = {}
    for family in families:
        names |= {quantity: name for quantity, name in family.names.items() if quantity not in names}
    return names


def headings_named(table: Table) -> list[Family]:
    """Headings in a table: quaternions before yaws.

    Beside `gaz` a yaw is a command, as Parrot's SDKs name them, if the command is not `yaw_rate` there. It is taken for
    the heading only of a position that has no other one.
    """
    found = [family for family in _families(table, _HEADINGS) if "yaw" in family.names or len(family.names) == 4]
    plain = {name_without_unit(name): name for name in series_of(table)}
    if not {"gaz", "yaw"} <= plain.keys() or plain.keys() & {"yaw_rate", "yaw_speed"}:
        return found
    others = [family for family in found if family.names.get("yaw") != plain["yaw"]]
    return others or (found if _families(table, _PLACES) else [])


def _pose(place: Family, places: Sequence[Family], headings: Sequence[Family]) -> NamedPose:
    """A family with the heading named most like it; axes that it lacks are of the next family that has them."""
    names = _filled([place, *places])
    heading = min(headings, key=lambda one: _distance(one, place, places), default=None)
    names |= heading.names if heading else {}
    rest = [next(iter(family.names.values())) for family in (*places, *headings) if family not in (place, heading)]
    unused = tuple(name for name in rest if name not in names.values())
    return NamedPose(names, tuple(axis for axis in "xyz" if axis in names and axis not in place.names), unused)


def _distance(heading: Family, place: Family, places: Sequence[Family]) -> tuple[int, bool]:
    """How unlike a heading is to a position: by the words that they share, and whether it is named like another."""
    elsewhere = heading.stem in {other.stem for other in places if other is not place}
    return -_shared(heading.stem, place.stem), elsewhere


def _shared(one: tuple[str, str], other: tuple[str, str]) -> int:
    """Number of words at the start and at the end that two stems share."""
    starts = zip(_words(one[0]), _words(other[0]), strict=False)
    ends = zip(reversed(_words(one[1])), reversed(_words(other[1])), strict=False)
    return sum(len(list(takewhile(lambda pair: pair[0] == pair[1], pairs))) for pairs in (starts, ends))


def _words(text: str) -> list[str]:
    return list(filter(None, text.split("_")))


def _families(table: Table, schemes: Sequence[Mapping[str, str]]) -> list[Family]:
    """Families of names: the fullest first, then those as long as a clock, then the shortest."""
    series, lengths = series_of(table), set(clocks(table).values())
    found: dict[tuple[int, tuple[str, str]], dict[str, str]] = {}
    for name in series:
        plain = name_without_unit(name)
        for scheme, patterns in enumerate(schemes):
            for quantity, pattern in patterns.items():
                if match := re.fullmatch(pattern, plain):
                    start, end = match.span(match.lastindex or 0)
                    found.setdefault((scheme, (plain[:start], plain[end:])), {}).setdefault(quantity, name)

    def rank(family: Family) -> tuple[int, bool, int]:
        sizes = (series[name] for name in family.names.values())
        untimed = any(not lengths & {size - 1, size, size + 1} for size in sizes)
        return -len(family.names), untimed, sum(map(len, family.names.values()))

    return sorted((Family(stem, names) for (_, stem), names in found.items()), key=rank)
