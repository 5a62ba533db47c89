"""Writers of the logs of autopilots for the tests: PX4's ULog and ArduPilot's DataFlash, record by record."""

import struct
from collections.abc import Iterable, Sequence

import numpy as np

ULOG_HEADER = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
ULOG_SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
ULOG_CODES = {"uint64_t": "Q", "int64_t": "q", "uint8_t": "B", "float": "f", "double": "d", "bool": "?", "int16_t": "h"}


def ulog_record(kind: str, *parts: bytes) -> bytes:
    content = b"".join(parts)
    return struct.pack("<HB", len(content), ord(kind)) + content


def ulog_format(name: str, fields: str) -> bytes:
    return ulog_record("F", f"{name}:{fields}".encode())


def ulog_subscription(number: int, name: str, instance: int = 0) -> bytes:
    return ulog_record("A", bytes([instance]), struct.pack("<H", number), name.encode())


def ulog_data(number: int, layout: str, *values: float) -> bytes:
    """A message; `layout` as struct has it."""
    return ulog_record("D", struct.pack(f"<H{layout}", number, *values))


ULOG_STATE = ulog_format("state", "uint64_t timestamp;float x;float[3] v;bool armed;uint8_t[7] _padding0;")


def ulog_states(stamps: Iterable[int], number: int = 0) -> list[bytes]:
    """Messages of `ULOG_STATE`, which the autopilot writes without the padding at the end: x counts milliseconds."""
    return [ulog_data(number, "Qf3f?", t, t / 1000, 1, 2, 3, t % 2 == 0) for t in stamps]


def ulog(*records: bytes | Iterable[bytes]) -> bytes:
    """A file: its header, then records one after the other."""
    return ULOG_HEADER + b"".join(part if isinstance(part, bytes) else b"".join(part) for part in records)


FLASH_CODES = {
    **dict(zip("bBhHiIfdqQM", "bBhHiIfdqQB", strict=True)), **dict(zip("cCeEL", "hHiIi", strict=True)), "n": "4s",
    "N": "16s", "Z": "64s", "a": "32h", "g": "e",
}  # fmt: skip


def flash_layout(format_: str) -> struct.Struct:
    return struct.Struct("<" + "".join(FLASH_CODES[code] for code in format_))


def flash_format(kind: int, name: str, format_: str, labels: str) -> bytes:
    length = 3 + flash_layout(format_).size
    texts = struct.pack("<4s16s64s", name.encode(), format_.encode(), labels.encode())
    return b"\xa3\x95\x80" + bytes([kind, length]) + texts


def flash_record(kind: int, format_: str, *values: object) -> bytes:
    flat: list[object] = []
    for value in values:
        flat += list(value) if isinstance(value, Sequence | np.ndarray) and not isinstance(value, bytes) else [value]
    return b"\xa3\x95" + bytes([kind]) + flash_layout(format_).pack(*flat)


FLASH_FMT = flash_format(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
FLASH_ATT = flash_format(1, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw")


def flash_attitudes(stamps: Iterable[int]) -> list[bytes]:
    """Messages of `FLASH_ATT`: roll is 0.01 degrees a millisecond."""
    return [flash_record(1, "QccC", t, t // 1000 % 30_000, -5, 35_999) for t in stamps]


def flash(*records: bytes | Iterable[bytes]) -> bytes:
    """A file: the definition of definitions, then records one after the other."""
    return FLASH_FMT + b"".join(part if isinstance(part, bytes) else b"".join(part) for part in records)
