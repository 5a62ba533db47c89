"""Air: mean wind, gusts with a Dryden spectrum, steps at stated times; world frame, uniform in space.

The longitudinal form drives gusts along the world's x axis, the transverse form those along y and z:

    Phi_x(w) = sigma^2 2 T / pi / (1 + (T w)^2)                                T = length / speed
    Phi_yz(w) = sigma^2 T / pi (1 + 3 (T w)^2) / (1 + (T w)^2)^2               one-sided, w in rad/s

Source: MIL-F-8785C, section 3.7.1.2, Dryden form.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.errors import LinkError
from rotorfit.core.frames import Array

Three = tuple[float, float, float]


@dataclass(frozen=True)
class Gusts:
    """Dryden turbulence.

    Attributes:
        intensity: Standard deviation along the world's x, y, z [m/s].
        length: Scale length [m].
        speed: Speed at which the frozen field passes the vehicle [m/s]; length / speed is the correlation time.
    """

    intensity: Three
    length: float = 1.0
    speed: float = 1.0

    def __post_init__(self) -> None:
        if min(self.intensity) < 0 or min(self.length, self.speed) <= 0:
            raise ValueError("gusts: intensity must not be negative, length and speed must be positive")


@dataclass(frozen=True)
class Rise:
    """Wind that changes linearly over an interval and then stays.

    Attributes:
        start: Start, since the start of the flight [s].
        end: End [s].
        mean: Added to the mean wind at the end, world [m/s].
        gusts: Factor on the gusts' standard deviation at the end.
    """

    start: float
    end: float
    mean: Three = (0.0, 0.0, 0.0)
    gusts: float = 1.0

    def __post_init__(self) -> None:
        if not self.start < self.end or self.gusts < 0:
            raise ValueError("rise: it must start before it ends, and its factor on gusts must not be negative")


@dataclass(frozen=True)
class Wind:
    """Motion of the air.

    Attributes:
        mean: Mean wind, world [m/s].
        gusts: None for none.
        steps: Changes of the mean: the time since the start [s] and what is added from then on [m/s]. A step takes
            0.02 s, one interval between the nodes of the wind.
        rises: Linear changes; their factors on the gusts multiply.
    """

    mean: Three = (0.0, 0.0, 0.0)
    gusts: Gusts | None = None
    steps: tuple[tuple[float, Three], ...] = ()
    rises: tuple[Rise, ...] = ()


def wind_at_nodes(wind: Wind, first: int, count: int, period: float, gusts: Array) -> Array:
    """Air velocity at nodes `first`, `first` + 1, ..., shape (count, 3) [m/s]; `gusts` are those at the same nodes."""
    time = (first + np.arange(count)) * period
    shares = [np.clip((time - rise.start) / (rise.end - rise.start), 0.0, 1.0)[:, None] for rise in wind.rises]
    for share, rise in zip(shares, wind.rises, strict=True):
        gusts = gusts * (1 + share * (rise.gusts - 1))
    air: Array = gusts + np.array(wind.mean)
    for share, rise in zip(shares, wind.rises, strict=True):
        air += share * np.array(rise.mean)
    for start, change in wind.steps:
        air[time > start] += np.array(change)
    return air


class GustSource:
    """Gusts at equally spaced nodes, drawn block by block from a generator of their own."""

    def __init__(self, gusts: Gusts | None, period: float, rng: np.random.Generator) -> None:
        """Starts in the stationary state.

        Args:
            gusts: None for still air.
            period: Time between nodes [s].
            rng: Generator for these gusts alone.
        """
        self._rng = rng
        self._sigma = np.array(gusts.intensity if gusts else (0.0, 0.0, 0.0))
        step = period * gusts.speed / gusts.length if gusts else 1.0  # in correlation times
        self._law = _dryden_steps(step)
        self._state = _stationary() @ rng.standard_normal((2, 3))

    def draw(self, count: int) -> Array:
        """The next `count` nodes, shape (count, 3) [m/s]."""
        normal = self._rng.standard_normal((count, 2, 3))
        gusts: Array = np.empty((count, 3))
        _run(self._state, normal, *self._law, gusts)
        gusts *= self._sigma
        return gusts


def _dryden_steps(h: float) -> tuple[Array, Array]:
    """Exact step of the two-state shaping filter over h correlation times: transition (2, 2), noise root (2, 2).

    With time in correlation times, z1' = -z1 + n and z2' = -z2 + z1 under white noise n: z1 alone has the longitudinal
    spectrum, z1 and z2 combined have the transverse one.
    """
    decay = math.exp(-h)
    transition = np.array([[decay, 0.0], [h * decay, decay]])
    return transition, np.asarray(np.linalg.cholesky(_covariance(h)), np.float64)


def _covariance(h: float) -> Array:
    """Covariance of (z1, z2) after h correlation times from rest, for noise of density 2 (z1 gets variance 1)."""
    d = math.exp(-2 * h)
    first = 1 - d
    cross = (1 - d * (1 + 2 * h)) / 2
    second = (1 - d * (1 + 2 * h + 2 * h * h)) / 2
    return np.array([[first, cross], [cross, second]])


def _stationary() -> Array:
    return np.linalg.cholesky(np.array([[1.0, 0.5], [0.5, 0.5]]))


@kernel()
def _run(state, normal, transition, root, gusts):  # type: ignore[no-untyped-def]
    """Steps the filters of three axes and fills gusts of unit variance."""
    for n in range(normal.shape[0]):
        for a in range(3):
            z1, z2 = state[0, a], state[1, a]
            if a == 0:
                gusts[n, a] = z1
            else:  # (1 + sqrt(3) s) / (1 + s)^2, over sqrt(2) for unit variance
                gusts[n, a] = (np.sqrt(3.0) * z1 + (1 - np.sqrt(3.0)) * z2) / np.sqrt(2.0)
            m1, m2 = normal[n, 0, a], normal[n, 1, a]
            state[0, a] = transition[0, 0] * z1 + root[0, 0] * m1
            state[1, a] = transition[1, 0] * z1 + transition[1, 1] * z2 + root[1, 0] * m1 + root[1, 1] * m2


def wind_of(options: Sequence[str], address: str) -> "Wind":
    """The wind of an address of a vehicle, as given on the command line, from its options; raises as `open_link`."""
    known = {"wind": 0.0, "gusts": 0.0}
    for option in reversed(options):  # the first of two counts
        key, equal, text = option.partition("=")
        try:
            if key not in known or not equal:
                raise ValueError
            known[key] = float(text)
        except ValueError:
            wanted = ", ".join(f"{name}=NUMBER" for name in known)
            raise LinkError(f"{address}: {option!r} is not one of {wanted}, in m/s") from None
    sigma = known["gusts"]
    if not (math.isfinite(known["wind"]) and 0 <= sigma < math.inf):
        raise LinkError(f"{address}: wind and gusts are finite, gusts not negative")
    return Wind((known["wind"], 0.0, 0.0), Gusts((sigma, sigma, sigma / 2)) if sigma else None)
