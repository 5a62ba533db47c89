"""Logs of a few hundred kilobytes that unpack to far more, one in each packed format."""

import bz2
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np

from rotorfit.files.logs.mcap_records import MAGIC

PIECE = 1 << 20


def _repeated(part: bytes, size: int) -> bytes:
    return part * (size // len(part))


def _field(name: str, value: bytes) -> bytes:
    return struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value


def _record1(header: list[tuple[str, bytes]], data: bytes) -> bytes:
    fields = b"".join(_field(*pair) for pair in header)
    return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data


def rosbag1(path: Path, method: str, chunk: int, count: int) -> Path:
    """Chunks of equal numbers (ROS 1), each unpacking to about `chunk` bytes."""
    pack: Callable[[bytes], bytes] = {"bz2": bz2.compress, "lz4": lz4.frame.compress}[method]
    text = [("topic", b"/n"), ("type", b"std_msgs/Float64"), ("md5sum", b"0" * 32)]
    text.append(("message_definition", b"float64 data"))
    number = struct.pack("<I", 0)
    told = b"".join(_field(*pair) for pair in text)
    connection = _record1([("op", b"\x07"), ("conn", number), ("topic", b"/n")], told)
    message = _record1([("op", b"\x02"), ("conn", number), ("time", bytes(8))], bytes(8))
    plain = connection + _repeated(message, chunk)
    head = [("op", b"\x05"), ("compression", method.encode()), ("size", struct.pack("<I", len(plain)))]
    start = _record1(
        [("op", b"\x03"), ("index_pos", bytes(8)), ("conn_count", number), ("chunk_count", number)], b" " * 3000
    )
    path.write_bytes(b"#ROSBAG V2.0\n" + start + _record1(head, pack(plain)) * count)
    return path


def _record(kind: int, data: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(data)) + data


def _text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def mcap(path: Path, method: str, chunk: int, count: int) -> Path:
    """Chunks of equal numbers (MCAP), each unpacking to about `chunk` bytes."""
    from rotorfit.files.logs.compression import _zstd

    pack: Callable[[bytes], bytes] = {"zstd": _zstd().compress, "lz4": lz4.frame.compress}[method]
    message = _record(5, struct.pack("<HIQQ", 1, 0, 0, 0) + b"\0\1\0\0" + bytes(8))
    plain = _repeated(message, chunk)
    packed = struct.pack("<QQQI", 0, 0, len(plain), 0) + _text(method.encode()) + struct.pack("<Q", 0) + pack(plain)
    known = _record(
        3, struct.pack("<H", 1) + _text(b"std_msgs/msg/Float64") + _text(b"ros2msg") + _text(b"float64 data")
    )
    known += _record(4, struct.pack("<HH", 1, 1) + _text(b"/n") + _text(b"cdr") + _text(b""))
    path.write_bytes(MAGIC + _record(1, _text(b"ros2") + _text(b"x")) + known + _record(6, packed) * count)
    return path


def mat(path: Path, size: int, count: int) -> Path:
    """Arrays of zeros (MATLAB 5), each of `size` bytes."""
    zeros, left = bytes(PIECE), size
    head = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, size // 8, 1)
    head += struct.pack("<II", 1, 1) + b"x" + bytes(7) + struct.pack("<II", 9, size)
    squeezer = zlib.compressobj(1)
    packed = squeezer.compress(struct.pack("<II", 14, len(head) + size) + head)
    while left:
        packed += squeezer.compress(zeros[: min(left, PIECE)])
        left -= min(left, PIECE)
    packed += squeezer.flush()
    start = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(start + (struct.pack("<II", 15, len(packed)) + packed) * count)
    return path


def parquet(path: Path, method: str, size: int) -> Path:
    """Columns of equal numbers, of `size` bytes together."""
    import polars as pl

    pl.DataFrame({f"c{k}": np.zeros(size // 32) for k in range(4)}).write_parquet(path, compression=method)
    return path
