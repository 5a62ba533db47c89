"""The filters of the likelihood over all blocks of a flight at once; the project takes them piece by piece."""

from collections.abc import Iterable

import numpy as np

from rotorfit.dynamics.whitening import Piece, axis_pieces, plane_pieces, turns

Array = np.ndarray


def whiten_axis(
    steps: Array, step: Array, count: Array, fresh: Array, columns: Array, levels: Array, few: int
) -> tuple[Array, Array, Array]:
    """All pieces of `axis_pieces` together: (B, C), (M - 1, B, few) and (M, B)."""
    return _joined(axis_pieces(steps, step, count, fresh, [columns], levels, few))


def whiten_plane(
    steps: Array, step: Array, count: Array, fresh: Array, yaw: Array, columns: Array, levels: Array, few: int
) -> tuple[Array, Array, Array]:
    """All pieces of `plane_pieces` together, at headings `yaw` (B,) [rad]: (B, 2, C), (M - 1, B, 2, few), (M, B, 2)."""
    return _joined(plane_pieces(steps, step, count, fresh, turns(yaw, fresh), [columns], levels, few))


def _joined(pieces: Iterable[Piece]) -> tuple[Array, Array, Array]:
    parts = [[part.copy() for part in arrays] for _, *arrays in pieces]
    first, others, variances = (np.concatenate(part, axis=min(n, 1)) for n, part in enumerate(zip(*parts, strict=True)))
    return first, others, variances
