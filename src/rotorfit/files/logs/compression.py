"""Bounded decompression of bz2, lz4 and zstd as used in bags."""

import bz2
import sys
from pathlib import Path
from typing import Any

from rotorfit.files.logs.content import BLOCK_LIMIT, DamageError

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_MOST_FRAMES = 64  # in one block; each costs a copy of the rest


def _zstd() -> Any:
    """The zstd module: in the standard library from Python 3.14 on, before that a dependency of rosbags."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


def unpacked(data: bytes | memoryview, method: str, size: int = BLOCK_LIMIT) -> bytes:
    """Decompresses a block.

    Args:
        data: Compressed bytes, possibly cut short.
        method: `bz2`, `lz4`, `zstd`, or `` and `none` for uncompressed bytes.
        size: Most bytes to return: the size that the block claims to have.

    Returns:
        The decompressed bytes; fewer than claimed if the block was cut short.

    Raises:
        DamageError: Unknown method, a claim beyond `BLOCK_LIMIT`, or bytes that are not of this method.
    """
    if size > BLOCK_LIMIT:
        raise DamageError(f"a block that claims {size} bytes unpacked, more than {BLOCK_LIMIT}")
    if method in ("", "none"):
        return bytes(data[:size])  # no copy where bytes come whole
    if method == "bz2":
        make: Any = bz2.BZ2Decompressor
        faults: tuple[type[Exception], ...] = (OSError, EOFError)
    elif method == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        make, faults = lz4.frame.LZ4FrameDecompressor, (RuntimeError, EOFError)
    elif method == "zstd":
        make, faults = _zstd().ZstdDecompressor, (_zstd().ZstdError, EOFError)
    else:
        raise DamageError(f"compression {method!r}, which is not known")
    parts: list[bytes] = []
    left, rest = size, data
    try:
        while rest and left > 0:  # a block may consist of several frames
            if len(parts) == _MOST_FRAMES:
                raise DamageError(f"a {method} block of more than {_MOST_FRAMES} frames")
            frame = make()
            parts.append(frame.decompress(rest, max_length=left))
            left -= len(parts[-1])
            rest = frame.unused_data if frame.eof else b""
    except faults as error:
        raise DamageError(f"a {method} block that does not unpack") from error
    return parts[0] if len(parts) == 1 else b"".join(parts)


def unpack_file(source: Path, target: Path, limit: int) -> None:
    """Decompresses a zstd file, as written by `ros2 bag record --compression-mode file`, to `target`.

    Raises:
        DamageError: Not zstd, or more than `limit` bytes. What was decompressed before the damage is in `target`.
    """
    zstd = _zstd()
    written = 0
    try:
        with zstd.open(source, "rb") as packed, target.open("wb") as plain:
            while block := packed.read(1 << 20):
                written += plain.write(block)
                if written > limit:
                    raise DamageError(f"more than {limit} bytes unpacked")
    except (zstd.ZstdError, EOFError) as error:
        raise DamageError("zstd data that ends early or is damaged") from error
