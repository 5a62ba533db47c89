"""The clock of live links: the time of day when the process started, running evenly since."""

import time

_START = time.time_ns() - time.monotonic_ns()


def wall_clock() -> int:
    """Time [ns] since 1970 that never jumps: corrections of the computer's clock during a flight do not reach it."""
    return _START + time.monotonic_ns()


def seconds_until(instant: int) -> float:
    """How long until the wall clock shows an instant [s]; 0 when it has passed."""
    return max(0.0, (instant - wall_clock()) / 1e9)
