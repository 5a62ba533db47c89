"""Evenly spaced stretches of a long record: enough to find an optimum, whose climb then ends on the whole record."""

from dataclasses import replace

import numpy as np

from rotorfit.core.laws import DELAY_RANGE
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.estimation.likelihood.blocks import Record

SEARCHED, STRETCH = 300.0, 30.0
"""Total length of the stretches of a record that is longer, and length of each [s]."""

LEAST = 10
"""Smallest number of blocks in a stretch."""


def stretches(rec: Record) -> Record:
    """The stretches of a long record, each as a segment of its own.

    A record that is not longer than `SEARCHED`, or that has velocities, is returned as it is.
    """
    time, segment = rec.block_time, rec.segment
    ends = np.append(np.flatnonzero(rec.fresh), time.size)
    every = STRETCH / SEARCHED * float(np.sum(time[ends[1:] - 1] - rec.starts))
    if every <= STRETCH or rec.rate is not None:
        return rec
    since = time - rec.starts[segment]
    place = np.unique(np.column_stack([segment, since // every]), axis=0, return_inverse=True)[1].ravel()
    inside = since % every < STRETCH
    kept = inside & (np.bincount(place, inside) >= LEAST)[place]
    keep = np.flatnonzero(kept)
    if not keep.size:
        return rec
    number = np.unique(place[keep], return_inverse=True)[1]
    fresh = np.diff(number, prepend=-1) > 0
    first = np.flatnonzero(fresh)
    last = np.append(first[1:], keep.size)
    samples = np.flatnonzero(kept[rec.block])
    block = (np.cumsum(kept) - 1)[rec.block[samples]]
    pose_range = np.column_stack([np.searchsorted(block, first), np.searchsorted(block, last)])
    pose_time = rec.pose_time[samples]
    starts = np.maximum(pose_time[pose_range[:, 0]], rec.starts[segment[keep[first]]])
    low, high = rec.command_range[segment[keep[first]]].T
    acting = np.clip(np.searchsorted(rec.command_time, starts - DELAY_RANGE[1], side="right") - 1, low, high)
    over = np.searchsorted(rec.command_time, pose_time[pose_range[:, 1] - 1] - DELAY_RANGE[0])
    steps, step = distinct_steps(time[keep])
    return replace(
        rec,
        starts=starts,
        rested=rec.rested[segment[keep[first]]] & (acting == low),
        pose_range=pose_range,
        command_range=np.column_stack([acting, np.clip(over, low, high)]),
        pose_time=pose_time,
        yaw=rec.yaw[samples],
        block=block,
        count=rec.count[keep],
        block_time=time[keep],
        steps=steps,
        step=step,
        block_yaw=rec.block_yaw[keep],
        position=rec.position[keep] - rec.position[keep[first]][number],
        fresh=fresh,
        size=None if rec.size is None else rec.size[keep],
    )
