"""Clocks: stamps of a stream, order, repeats, jitter, gaps, and the relation of two clocks.

`increasing` and `fresh` only look back, as a live stream must; a file is sorted by `in_time`.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from rotorfit.core.card import Channel
from rotorfit.core.errors import CardError
from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.core.log import Log
from rotorfit.flights.columns import SINCE_1970, raw_column, stated_unit, table_of

Stamps = npt.NDArray[np.int64]
"""Stamps of a stream, shape (N,) [ns]."""

MISSING_STAMP = int(np.iinfo(np.int64).min)
"""Represents a stamp that was recorded as NaN, as numpy's NaT does."""

GAP_PERIODS = 3
"""A step longer than this many median periods is a gap."""

GAP_TOLERANCE = 0.01
"""Share of a median period by which a step may exceed the limit: a rounded step of exactly three periods is no gap."""

SPIN = 20.0
"""Fastest plausible turn [rad/s]: no velocity-commanded multirotor reaches it."""

COARSE = 4.0
"""A column counts as coarsely rounded where its median change is below this multiple of its smallest changes."""

AHEAD, APART = 10**9, 3600 * 10**9
"""Steps of the clock beyond which a single stamp is stray [ns]: there and back, and at either end."""

FEW, FEWEST_REPEATS, TOGETHER = 0.15, 20, 50
"""Share below which what rounding does not do is chance; least number of pauses that decide; rows that are compared."""

GOES_ON = 20
"""Fewest samples of a recording: fewer, before or after a clock starts again, are stray."""

PASSED = 5
"""Samples that a run of late ones in order goes over again where the clock was set back. Samples that were only written
late come in any order, or fill the hole that they left."""

ROUND = (2**32 * 10**3, 2**32 * 10**6, 43_200 * 10**9, 86_400 * 10**9)
"""After how long clocks start again [ns]: a counter of microseconds or milliseconds with 32 bits, and times of day."""

OVER_THE_END = 10**9
"""Longest step over the end of such a clock [ns]."""

REPEATING = 0.05
"""Share of repeated poses from which on it is judged why they repeat."""

STRETCH, EACH = 20, 10
"""Rows in which repeats are counted: at least so many, and so many poses."""

EVEN, SURE = 0.5, 2.5
"""Share of the binomial variance below which repeats come evenly (of slower poses in recorded and simulated rows at
most 0.3, of lost frames at least 0.9), and by how many standard errors of that variance."""

_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


@dataclass(frozen=True)
class Rate:
    """Regularity of a stream's stamps. None where fewer than two increasing stamps leave a value undefined.

    Attributes:
        count: Number of stamps recorded.
        duration: From the first to the last increasing stamp [s].
        period: Median step [s].
        jitter: 5th and 95th percentiles of step minus period [s].
        gaps: Number of steps longer than three periods.
        longest_gap: Longest step [s].
        repeated: Number of stamps equal to the latest before.
        reversed: Number of stamps earlier than the latest before.
        missing: Number of stamps that are not numbers.
    """

    count: int
    duration: float
    period: float | None
    jitter: tuple[float, float] | None
    gaps: int
    longest_gap: float | None
    repeated: int
    reversed: int
    missing: int


@dataclass(frozen=True)
class ClockRelation:
    """Relation of the stamps of one stream to those of another.

    Attributes:
        start_offset: First stamp of the second minus that of the first [s].
        end_offset: Last stamp of the second minus that of the first [s].
        overlap: Length of the time covered by both [s]; 0 where they are disjoint.
    """

    start_offset: float
    end_offset: float
    overlap: float


@dataclass(frozen=True)
class ClockDrift:
    """Relation of two clocks that stamped the same samples.

    Attributes:
        offset: Median of second minus first [s].
        spread: 5th and 95th percentiles of second minus first, relative to the offset [s].
        drift: Change of second minus first per second, from the medians of the first and last quarters.
    """

    offset: float
    spread: tuple[float, float]
    drift: float


def stamps_of(log: Log, time: Channel) -> Stamps:
    """Stamps of a stream in nanoseconds.

    Stamps in `log.retimed` are returned unchanged. Otherwise, without a unit, they are nanoseconds where two of these
    hold: they are integers, or were before blanks made floats of them; the column is a `header.stamp` or `log_time`;
    they exceed 1e15. Everything else is seconds.

    Args:
        log: Log that holds the column.
        time: The column, and how to read it: raw * scale + offset, in its unit.

    Returns:
        Shape (N,) [ns]; `MISSING_STAMP` where the recorded stamp is not a number, or does not fit int64.

    Raises:
        CardError: The column is missing, or most of its numbers are too large for their unit.
    """
    name, raw = raw_column(log, time.source)
    moved = log.retimed.get((table_of(log, str(time.source))[0].name, name)) if log.retimed else None
    if moved is not None:
        return moved
    finite, integers = np.isfinite(raw), raw.dtype.kind in "iu"
    whole = integers or (not np.all(finite) and bool(np.all(raw[finite] % 1 == 0)))  # blanks made floats of them
    sizes = np.abs(np.where(finite, raw, 0).astype(np.float64))
    of_message = name.endswith("header.stamp") or name == "log_time"
    large = bool(np.any(finite)) and float((np.max if integers else np.median)(sizes[finite])) > 1e15
    unit = time.unit or ("ns" if (whole + of_message + large) > 1 else "s")
    factor = _NS[unit]
    in_range = finite & (sizes * abs(time.scale) + abs(time.offset) < 2.0**62 / factor)
    if np.sum(in_range) < np.sum(finite) / 2:
        typical = float(np.median(sizes[finite]))
        counted = {each: typical * _NS[each] / 1e9 for each in ("ms", "us", "ns")}
        likely = next((each for each, seconds in counted.items() if SINCE_1970[0] < seconds < SINCE_1970[1]), "ns")
        advice = (
            "correct the unit that the file states, to"
            if stated_unit(log, time) == unit
            else "add their unit, as unit ="
        )
        raise CardError(
            f"{log.path}: stamps of {time.source} are about {typical:.3g} {unit}: {advice} "
            f'"{likely}", which would be {counted[likely]:.3g} s'
        )
    kept = np.where(in_range, raw, 0)
    if whole and time.scale == 1:  # exact: float64 would round nanoseconds since 1970 to 256 ns
        stamps = kept.astype(np.int64) * factor + round(time.offset * factor)
    else:
        values = kept.astype(np.float64) * time.scale + time.offset
        units = np.floor(values)  # split off the fraction, so that the product does not round a second time
        stamps = units.astype(np.int64) * factor + np.round((values - units) * factor).astype(np.int64)
    return np.where(in_range, stamps, MISSING_STAMP)


def stray(stamps: Stamps) -> Mask:
    """Which single stamps belong to no clock, shape (N,): those after them would count as too early, or days as flown.

    One is ahead of both neighbours, which follow each other; or it is the first or last of all, far from its neighbour,
    as the zero of a header that was not filled in yet is from the epoch.
    """
    out = np.zeros(len(stamps), dtype=np.bool_)
    if len(stamps) < 3:
        return out
    steps = np.diff(stamps)
    out[1:-1] = (steps[:-1] > AHEAD) & (steps[1:] < -AHEAD) & (stamps[2:] > stamps[:-2])
    out[0] = steps[0] > APART or (steps[0] < -AHEAD and steps[1] > 0)
    out[-1] = steps[-1] > APART
    return out


def continued(stamps: Stamps) -> Stamps:
    """Stamps of a clock that starts again, from midnight or from the end of its counter, as if it went on."""
    out = stamps.copy()
    there = np.flatnonzero(stamps != MISSING_STAMP)
    steps = np.diff(stamps[there])
    for i in np.flatnonzero(steps < -AHEAD):
        length = next((one for one in ROUND if 0 <= int(steps[i]) + one < OVER_THE_END), 0)
        out[there[i + 1 :]] += length
    return out


def restarts(stamps: Stamps) -> list[int]:
    """Rows at which a clock starts again, as of a second recording in the file: it loses more than half of its time.

    A clock that is set right loses less, and one that starts again at the end of its counter goes on.
    """
    rows = np.flatnonzero(stamps != MISSING_STAMP)
    if not np.any(np.diff(stamps[rows]) < -AHEAD):
        return []
    rows = rows[~stray(stamps[rows])]
    clock = continued(stamps[rows])
    begin, found = 0, []
    for i in (np.flatnonzero(np.diff(clock) < -AHEAD) + 1).tolist():
        first, latest, after = int(clock[begin]), int(np.max(clock[begin:i])), clock[i : i + GOES_ON]
        long = i - begin >= GOES_ON == len(after)
        if long and clock[i] - first < (latest - first) / 2 and np.max(after) < latest:
            begin = i
            found.append(int(rows[i]))
    return found


def increasing(stamps: Stamps) -> Mask:
    """Which stamps are later than all before them, shape (N,). The first of equal ones is kept."""
    keep = np.ones(len(stamps), dtype=np.bool_)
    keep[1:] = stamps[1:] > np.maximum.accumulate(stamps)[:-1]
    return keep


def set_back(stamps: Stamps) -> Mask:
    """Which stamps of a file no sorting can place, shape (N,).

    They are more than a second earlier than one before them, or in a run of earlier ones in which the clock goes over
    a stretch of time again.
    """
    latest = np.maximum.accumulate(stamps)
    late = stamps < latest
    out = np.asarray(latest - stamps > AHEAD)
    starts = np.flatnonzero(late & ~np.append(False, late[:-1]))
    if not starts.size:
        return out
    prompt, never = stamps[~late], np.iinfo(np.int64)
    low = np.minimum.reduceat(np.where(late, stamps, never.max), starts)
    high = np.maximum.reduceat(np.where(late, stamps, never.min), starts)
    passed = np.searchsorted(prompt, high, side="right") - np.searchsorted(prompt, low)
    back = np.append(np.diff(stamps) < 0, False) & np.append(late[1:], False)
    in_order = np.add.reduceat(back, starts, dtype=np.int64) == 0
    lengths = np.add.reduceat(late, starts, dtype=np.int64)
    again = (np.minimum(passed, lengths) > PASSED) & (in_order | out[starts])
    out[late] |= np.repeat(again, lengths)
    return out


def in_time(stamps: Stamps) -> Indices:
    """Rows of a file in the order of their stamps, without those of `set_back` and those that repeat a stamp."""
    rows = np.flatnonzero(~set_back(stamps))
    rows = rows[np.argsort(stamps[rows], kind="stable")]
    return np.asarray(rows[increasing(stamps[rows])])


def fresh(values: Array) -> Mask:
    """Which rows of shape (N, K) differ from the row before in any column, shape (N,). The first of a run is kept."""
    keep = np.ones(len(values), dtype=np.bool_)
    keep[1:] = np.any(values[1:] != values[:-1], axis=1)
    return keep


def grain(values: Array) -> Array:
    """Rounding step of each column of values (N, K), shape (K,); 0 where it is fine compared with the changes.

    It is coarse where the median change is less than `COARSE` times the smallest ones.
    """
    out = np.zeros(values.shape[1])
    for k, step in enumerate(np.abs(np.diff(values, axis=0)).T):
        changes = step[step > 0]
        if changes.size:
            small = float(np.quantile(changes, 0.05))
            out[k] = small if np.median(changes) < COARSE * small else 0.0
    return out


def coarse(values: Array) -> bool:
    """Whether all columns of values (N, K) that change are so coarse that equal neighbours are genuine."""
    moving = np.ptp(values, axis=0) > 0
    return bool(np.all(grain(values[:, moving]) > 0))


def rounded_repeats(values: Array) -> bool:
    """Whether rows of shape (N, K) that repeat the row before are due to rounding, and not to a sample sent twice.

    Rounded columns change each at its own time, by one step after a pause, and at no regular interval. What is sent
    twice changes in all columns at once, by several steps, or at every n-th row.
    """
    step = grain(values)
    moving = np.ptp(values, axis=0) > 0
    if not np.any(moving) or not np.all(step[moving] > 0):
        return False
    moved = np.abs(np.diff(values[:, moving], axis=0)) / step[moving]
    changes = moved > 0.5
    new = np.flatnonzero(np.any(changes, axis=1))
    paused = new[1:][np.diff(new) > 1]
    if paused.size < FEWEST_REPEATS or np.mean(np.any(moved[paused] > 1.5, axis=1)) > FEW:
        return False
    parts = np.array_split(changes, max(len(changes) // TOGETHER, 1))
    seen = sum(len(part) * float(np.mean(~np.any(part, axis=1))) for part in parts)
    alone = sum(len(part) * float(np.prod(1 - np.mean(part, axis=0))) for part in parts)
    regular = max(np.max(np.bincount(new % n, minlength=n)) / new.size - 1 / n for n in range(2, 11))
    return bool(seen < (1 + FEW) * alone and regular < FEW)


def rows_of_slower(stamps: Stamps, again: Mask) -> float:
    """Period of rows that each hold the latest of slower poses [s]; 0 where poses have rows of their own.

    Slower poses at a rate of their own repeat in every stretch of rows as often as in the next, frames that are lost
    at random do not: their number in a stretch has the variance of a binomial distribution, or more.

    Args:
        stamps: Increasing, shape (N,) [ns].
        again: Which rows repeat the pose before, shape (N,).
    """
    rate = 1 - float(np.mean(again)) if again.size else 0.0
    if not REPEATING < 1 - rate < 1:
        return 0.0
    size = max(STRETCH, round(EACH / rate))
    number = np.sum(again[: again.size // size * size].reshape(-1, size), axis=1)
    number = number[number < size]  # a pose that stays for so long stands on the ground, or is lost
    if number.size < 2:
        return 0.0
    share = float(np.mean(number)) / size
    even = float(np.var(number)) < min(EVEN, 1 - SURE * np.sqrt(2 / number.size)) * size * share * (1 - share)
    return float(np.median(np.diff(stamps))) / 1e9 if even else 0.0


def held(clock: Stamps, values: Array, at: Stamps) -> Array:
    """Latest value, of shape (N,), at or before each of the stamps `at`, shape (M,); NaN before the first."""
    order = np.argsort(clock, kind="stable")
    index = np.searchsorted(clock[order], at, side="right") - 1
    return np.where(index >= 0, values[order][np.maximum(index, 0)], np.nan)


def degrees_for_radians(stamps: Stamps, yaw: Array) -> bool:
    """Whether headings read as radians must be degrees.

    They must where one jumps by 360, or where they leave one turn and keep moving faster than 20 rad/s over a tenth
    of a second; neither a wrapped nor an unwrapped angle of a real vehicle does that.

    Args:
        stamps: Increasing, shape (N,) [ns].
        yaw: As read, wrapped or not, shape (N,) [rad].
    """
    if np.any(np.abs(np.abs(np.diff(yaw)) - 360) < 30):
        return True
    if len(yaw) < 20 or np.ptp(yaw) < 2 * np.pi + 0.5:
        return False
    lag = max(1, round(1e8 / float(np.median(np.diff(stamps)))))
    turned = np.unwrap(yaw)
    if lag >= len(yaw):
        return False
    speed = np.abs(turned[lag:] - turned[:-lag]) / ((stamps[lag:] - stamps[:-lag]) / 1e9)
    return bool(np.mean(speed > SPIN) > 0.01)


def median_period(stamps: Stamps) -> int | None:
    """Median step of increasing stamps [ns]; None for fewer than two."""
    return round(float(np.median(np.diff(stamps)))) if len(stamps) > 1 else None


def rate(stamps: Stamps) -> Rate:
    """Rate, jitter, gaps and disorder of the recorded stamps of a stream, shape (N,) [ns]."""
    there = stamps[stamps != MISSING_STAMP]
    ordered = there[in_time(there)]
    latest = np.maximum.accumulate(there)[:-1]
    period = median_period(ordered)
    steps = np.diff(ordered)
    low, high = np.percentile(steps - period, (5, 95)) / 1e9 if period is not None else (0.0, 0.0)
    limit = (GAP_PERIODS + GAP_TOLERANCE) * (period or 0)
    return Rate(
        count=len(stamps),
        duration=float(ordered[-1] - ordered[0]) / 1e9 if len(ordered) else 0.0,
        period=None if period is None else period / 1e9,
        jitter=None if period is None else (float(low), float(high)),
        gaps=int(np.sum(steps > limit)),
        longest_gap=None if period is None else float(np.max(steps)) / 1e9,
        repeated=int(np.sum(there[1:] == latest)),
        reversed=int(np.sum(there[1:] < latest)),
        missing=len(stamps) - len(there),
    )


def relation(first: Stamps, second: Stamps) -> ClockRelation:
    """Relation in time of two streams, each with at least one stamp, increasing [ns]."""
    overlap = min(int(first[-1]), int(second[-1])) - max(int(first[0]), int(second[0]))
    return ClockRelation(
        start_offset=(int(second[0]) - int(first[0])) / 1e9,
        end_offset=(int(second[-1]) - int(first[-1])) / 1e9,
        overlap=max(overlap, 0) / 1e9,
    )


def drift(first: Stamps, second: Stamps) -> ClockDrift | None:
    """Drift of the second of two clocks against the first, over the samples stamped by both [ns].

    Medians of quarters are used because transport delays have a one-sided long tail. None for fewer than eight samples,
    or where the first clock stands still.
    """
    both = (first != MISSING_STAMP) & (second != MISSING_STAMP)
    if np.sum(both) < 8:
        return None
    difference = (second[both] - first[both]) / 1e9
    offset = float(np.median(difference))
    low, high = np.percentile(difference - offset, (5, 95))
    time = (first[both] - first[both][0]) / 1e9
    quarter = len(time) // 4
    elapsed = float(np.median(time[-quarter:]) - np.median(time[:quarter]))
    if elapsed <= 0:
        return None
    growth = float(np.median(difference[-quarter:]) - np.median(difference[:quarter]))
    return ClockDrift(offset=offset, spread=(float(low), float(high)), drift=growth / elapsed)
