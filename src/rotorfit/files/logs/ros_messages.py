"""ROS messages: from bytes and the definition in the bag to columns of numbers.

Nothing generated from a bag is executed. A definition is parsed to a list of fields; a walk over one message locates
each number; all messages of the same shape (same length, same lengths of strings) are then read at once as one
structured array. Poses are decoded thirty times faster than one by one.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from rotorfit.core.log import Column
from rotorfit.files.logs.batches import Messages, byte_rows
from rotorfit.files.logs.content import WIDEST, DamageError, one_line

Fields = Sequence[tuple[str, Any]]

Types = Mapping[str, Fields]
"""Message type to its fields; a field is a name and its kind and details as returned by rosbags' parsers."""

BULK_TYPES = frozenset(
    f"sensor_msgs/msg/{name}"
    for name in ("Image", "CompressedImage", "PointCloud", "PointCloud2", "LaserScan", "MultiEchoLaserScan")
) | {"nav_msgs/msg/OccupancyGrid", "stereo_msgs/msg/DisparityImage", "theora_image_transport/msg/Packet"}
"""Topics of these types are pixels and ranges, decoded only when requested by name."""

_BOOL = "?1"

_NUMBERS = {
    "bool": _BOOL,
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    **{f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4, 8)},
    "float32": "f4",
    "float64": "f8",
}

_BASE, _NAME, _ARRAY = 1, 2, 3  # kinds of fields as numbered by rosbags (interfaces.Nodetype); 4 is a sequence

_TIME, _DURATION = "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"

_FILLER = "structure_needs_at_least_one_member"  # the only field of an empty message in ROS 2

_COMPUTED = re.compile(r"<<|\bconst\b[^;]*=[^;]*\*")  # an untrusted one may grow without bound

_DEEPEST, _MOST_STEPS, _LONGEST, _MOST_SHAPES = 24, 100_000, 1 << 18, 32


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of a bag and the encoding of its messages.

    Attributes:
        name: Name, as recorded.
        msgtype: Type in the form `package/msg/Name`.
        encoding: `cdr` (ROS 2), `ros1`, or an unsupported name.
        definition: Text of the definition; empty where the bag has none.
        language: Language of the definition: `msg` or `idl`.
    """

    name: str
    msgtype: str
    encoding: str
    definition: str = ""
    language: Literal["msg", "idl"] = "msg"


def normal_type(name: str) -> str:
    """Converts a ROS 1 type `package/Name` to `package/msg/Name`."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


def types_of(topic: Topic) -> Types:
    """Parses the definition of a topic's type and of all nested types; standard types need no definition in the bag.

    Raises:
        DamageError: Unknown encoding, no definition, or one that cannot be parsed.
    """
    from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

    if topic.encoding not in ("cdr", "ros1"):
        raise DamageError(f"encoding {topic.encoding!r} is not read, only cdr and ros1")
    store = get_typestore(Stores.ROS1_NOETIC if topic.encoding == "ros1" else Stores.ROS2_HUMBLE)
    types: dict[str, Fields] = {name: fields for name, (_, fields) in store.fielddefs.items()}
    text = topic.definition.replace("\r\n", "\n")
    if len(text) > _LONGEST:
        raise DamageError(f"its definition is longer than {_LONGEST >> 10} KiB")
    try:
        if topic.language == "idl":
            if _COMPUTED.search(text):
                raise DamageError("its definition computes constants, which is not read")
            for part in _idl_parts(text):
                types |= {name: fields for name, (_, fields) in get_types_from_idl(part).items()}
        elif text or topic.msgtype not in types:
            if not text:
                raise DamageError(
                    "its definition is neither in the bag nor among the standard ones; "
                    "`ros2 bag convert` to MCAP puts it in where its package is installed"
                )
            types |= {name: fields for name, (_, fields) in get_types_from_msg(text, topic.msgtype).items()}
    except (TypesysError, RecursionError, ValueError, LookupError, TypeError, ArithmeticError, AssertionError) as error:
        raise DamageError(f"its definition cannot be parsed ({one_line(error)})") from error
    if topic.msgtype not in types:
        raise DamageError("its definition is of another type")
    return types


def has_numbers(types: Types, typename: str) -> bool:
    """Whether a type has a stamp, a number or an array of numbers outside of lists of other types."""
    seen: set[str] = set()
    ahead = [typename]
    while ahead:
        name = ahead.pop()
        if name in (_TIME, _DURATION):
            return True
        seen.add(name)
        for label, kind in types.get(name, ()):
            if kind[0] == _NAME:
                ahead += [kind[1]] if kind[1] not in seen else []
            else:
                inner = kind if kind[0] == _BASE else kind[1][0]
                if inner[0] == _BASE and inner[1][0] != "string" and label != _FILLER:
                    return True
    return False


def _idl_parts(text: str) -> list[str]:
    """Parts of an IDL definition as concatenated by ROS 2: a line of equal signs, `IDL: name`, the text."""
    bar = "=" * 80 + "\nIDL: "
    if not text.startswith(bar):
        return [text]
    return [part.partition("\n")[2] for part in text.split(bar)[1:]]


@dataclass(frozen=True)
class _Leaf:
    """One column in a message: `count` is None for a single number, `stamp` marks seconds and nanoseconds."""

    name: str
    format: str
    offset: int
    count: int | None = None
    stamp: bool = False


@dataclass
class _Walk:
    """A walk over one message along its definition; it collects the offsets of numbers and of lengths.

    Attributes:
        data: The message.
        types: Definitions.
        ros1: Whether it is in the ROS 1 format: packed, without alignment.
        order: Byte order of the numbers.
        position: Offset of the next byte.
        leaves: Columns found so far.
        lengths: Offsets of the four-byte lengths of strings and sequences, which define the shape of a message.
        steps: Number of types walked, for the limit.
    """

    data: bytes
    types: Types
    ros1: bool
    order: str = "<"
    position: int = 0
    leaves: list[_Leaf] = field(default_factory=list)
    lengths: list[int] = field(default_factory=list)
    steps: int = 0

    def message(self, typename: str) -> None:
        """Walks the whole message.

        Raises:
            DamageError: The message does not match the definition.
        """
        if not self.ros1:
            if self.data[:2] not in (b"\0\0", b"\0\1") or len(self.data) < 4:
                raise DamageError("a message that is not plain CDR")
            self.order = "<" if self.data[1] else ">"
            self.position = 4
        self.struct(typename, "", 0)
        surplus = len(self.data) - self.position
        if surplus < 0 or surplus > (0 if self.ros1 else 3):  # CDR may be padded to four bytes
            raise DamageError(f"a message of {len(self.data)} bytes where the definition says {self.position}")

    def struct(self, typename: str, name: str, depth: int, quiet: bool = False) -> None:
        """Walks the fields of a type; `quiet` adds no columns, as for the elements of a list."""
        self.steps += 1
        if depth > _DEEPEST or self.steps > _MOST_STEPS + len(self.data):
            raise DamageError("a definition that nests too deeply")
        if typename in (_TIME, _DURATION):
            start = self.skip(4, 2)
            if not quiet:
                seconds = "u4" if self.ros1 and typename == _TIME else "i4"
                self.leaves.append(_Leaf(name, seconds, start, stamp=True))
            return
        if typename not in self.types:
            raise DamageError(f"the definition of {typename} is not in the bag")
        fields = self.types[typename]
        if not self.ros1 and not fields:
            self.skip(1, 1)
        for label, kind in fields:
            if label != _FILLER:
                self.field(f"{name}.{label}" if name else label, kind, depth, quiet)
            elif not self.ros1:
                self.skip(1, 1)

    def field(self, name: str, kind: Any, depth: int, quiet: bool) -> None:
        """Walks one field: a number, a string, a type, an array or a sequence of them."""
        if kind[0] == _BASE:
            self.base(name, kind[1][0], None, quiet)
        elif kind[0] == _NAME:
            self.struct(kind[1], name, depth + 1, quiet)
        else:
            (inner, detail), size = kind[1]
            count = size if kind[0] == _ARRAY else self.length()
            if inner == _BASE:
                self.base(name, detail[0], count, quiet)
            else:
                for _ in range(count):
                    before = self.position
                    self.struct(detail, name, depth + 1, quiet=True)
                    if self.position == before:  # elements without bytes: as many as one likes
                        break

    def base(self, name: str, number: str, count: int | None, quiet: bool) -> None:
        """Walks a number or a string, or `count` of them."""
        if number == "string":
            for _ in range(1 if count is None else count):
                self.skip(1, self.length())
            return
        if number not in _NUMBERS:
            raise DamageError(f"a field of type {number}, which is not read")
        format_ = _NUMBERS[number]
        start = self.skip(int(format_[1]), 1 if count is None else count)
        if not quiet and (count is None or count <= WIDEST):
            self.leaves.append(_Leaf(name, format_, start, count))

    def length(self) -> int:
        """Reads the length of a string or of a sequence."""
        start = self.skip(4, 1)
        self.lengths.append(start)
        return int.from_bytes(self.data[start : start + 4], "little" if self.order == "<" else "big")

    def skip(self, size: int, count: int) -> int:
        """Advances past `count` numbers of `size` bytes; returns the offset of the first."""
        if not self.ros1 and count:
            self.position += -(self.position - 4) % size  # alignment counts from behind the CDR header
        start = self.position
        self.position += size * count
        if self.position > len(self.data):
            raise DamageError(f"a message that ends after {len(self.data)} bytes, inside a field")
        return start


@dataclass(frozen=True)
class Decoded:
    """Columns of a batch of messages.

    columns: Name to values, shape (N,) or (N, M).
    rows: Indices of the messages they came from, shape (N,).
    uneven: Names left out because their length differs between messages.
    fault: Why the first undecodable message failed; empty if all were decoded.
    """

    columns: dict[str, Column]
    rows: npt.NDArray[np.int64]
    uneven: frozenset[str]
    fault: str


def decoded(topic: Topic, types: Types, messages: Messages) -> Decoded:
    """Decodes messages of one topic, all those of the same shape at once."""
    parts: list[tuple[npt.NDArray[np.int64], dict[str, Column]]] = []
    fault = ""
    for members in _by_length(messages.lengths):
        block = byte_rows(messages.data, messages.starts[members], int(messages.lengths[members[0]]))
        left, shapes = np.arange(len(members)), 0
        while len(left):
            walk = _Walk(block[left[0]].tobytes(), types, topic.encoding == "ros1")
            try:
                walk.message(topic.msgtype)
            except DamageError as error:
                fault, left = fault or str(error), left[1:]
                continue
            shapes += 1  # of many shapes each message is its own: to look for others like it would take too long
            same = _of_same_shape(block, left, walk) if shapes < _MOST_SHAPES else np.arange(len(left)) == 0
            parts.append((members[left[same]], _numbers(block, left[same], walk)))
            left = left[~same]
    return _joined(parts, fault)


def _by_length(lengths: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
    """Groups rows of equal length, keeping their order."""
    if len(lengths) == 0 or (lengths == lengths[0]).all():
        return [np.arange(len(lengths))] if len(lengths) else []
    order = np.argsort(lengths, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(lengths[order])) + 1)


def _of_same_shape(block: npt.NDArray[np.uint8], rows: npt.NDArray[np.int64], walk: _Walk) -> npt.NDArray[np.bool_]:
    """Which rows have the same lengths of strings and sequences (and byte order) as the first of them."""
    places = [offset + byte for offset in walk.lengths for byte in range(4)]
    if not walk.ros1:
        places += [0, 1]
    shape = block[np.ix_(rows, np.array(places, dtype=np.int64))]
    return np.asarray((shape == shape[0]).all(axis=1))


def _numbers(block: npt.NDArray[np.uint8], rows: npt.NDArray[np.int64], walk: _Walk) -> dict[str, Column]:
    """Columns of messages of one shape; stamps as int64 nanoseconds."""
    record = np.dtype(
        {
            "names": [str(index) for index in range(len(walk.leaves))],
            "formats": [_format(leaf, walk.order) for leaf in walk.leaves],
            "offsets": [leaf.offset for leaf in walk.leaves],
            "itemsize": block.shape[1],
        }
    )
    whole = len(rows) == len(block)
    records = (block if whole else block[rows]).reshape(-1).view(record) if walk.leaves else None
    columns: dict[str, Column] = {}
    for index, leaf in enumerate(walk.leaves):
        assert records is not None
        values = records[str(index)]
        if leaf.stamp:
            columns[leaf.name] = values["s"].astype(np.int64) * 1_000_000_000 + values["n"]
        elif leaf.format == _BOOL:
            columns[leaf.name] = values.astype(np.uint8) != 0
        else:
            columns[leaf.name] = values.astype(values.dtype.newbyteorder("="))
    return columns


def _format(leaf: _Leaf, order: str) -> Any:
    """Numpy format of a leaf; booleans as bytes, because untrusted ones may be neither 0 nor 1."""
    if leaf.stamp:
        return np.dtype([("s", order + leaf.format), ("n", order + ("u4" if leaf.format == "u4" else "i4"))])
    number = "u1" if leaf.format == _BOOL else order + leaf.format
    return number if leaf.count is None else (number, (leaf.count,))


def _joined(parts: list[tuple[npt.NDArray[np.int64], dict[str, Column]]], fault: str) -> Decoded:
    """Merges the messages of all shapes in their original order; columns that differ between shapes are left out."""
    if not parts:
        return Decoded({}, np.zeros(0, np.int64), frozenset(), fault)
    first = parts[0][1]
    alike = [
        name
        for name, values in first.items()
        if all(name in other and other[name].shape[1:] == values.shape[1:] for _, other in parts)
    ]
    uneven = frozenset(name for _, columns in parts for name in columns if name not in alike)
    rows = np.concatenate([part for part, _ in parts])
    order = np.argsort(rows, kind="stable")
    columns = {name: np.concatenate([columns[name] for _, columns in parts])[order] for name in alike}
    return Decoded(columns, rows[order], uneven, fault)
