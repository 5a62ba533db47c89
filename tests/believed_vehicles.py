"""Vehicles of a family that is believed possible, as links in simulated time, for tests and bench.

    p' = v        v' = R (g a - b v') + c + w        a follows u(t - T) with a lag of 0.1 s

tilt-, velocity- and acceleration-commanded, the delay believed to be 0.15 to 0.5 s and in truth up to 0.6 s, with a
steady wind and gusts. The estimator's formulas are not used.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flying import CARD, SPACE, flown
from rotorfit.core.flight_plan import Four, Plan
from rotorfit.core.frames import Array
from rotorfit.core.log import Sample
from rotorfit.files.logs import read
from rotorfit.flying.links.link import Action, Silence
from rotorfit.planning.belief import Belief, belief_mapping, sample_vehicles
from rotorfit.simulation.paper_vehicle import Truth

STEP = 0.005
"""Of the integration [s]."""

LAG = 0.1
"""Of the attitude loop, of which the belief knows nothing [s]."""

GUST_TIME = 1.0
"""Correlation time of gusts [s]."""

SLOWEST, LONGEST = 0.02, 0.6
"""Least damping [1/s], and longest delay [s]."""

KINDS = {"tilt": (3.57, 0.40, 0.27), "velocity": (2.0, 2.0, 1.0), "acceleration": (1.0, 0.05, 0.03)}
"""Input, damping and its standard deviation on x and y, by what a command asks for."""

DELAYS = ((0.15, 0.10), (0.30, 0.10), (0.50, 0.05))
"""Mean and standard deviation of what is believed of the delay [s]."""

WIND = 0.1
"""Speed at which the steady wind of a third of the flights carries off a vehicle of the kind's damping [m/s]."""


@dataclass(frozen=True)
class Case:
    """One vehicle, what is believed of it, and where it is.

    Attributes:
        kind: Of `KINDS`.
        plan: One second of nothing: what counts is the way to its start.
        truth: The vehicle.
        push: Steady acceleration of the wind, world [m/s^2].
        gusts: Standard deviation of what comes on top [m/s^2].
        start: Where it hovers, x, y, z, yaw [m, rad].
        seed: Of gusts and noise.
    """

    kind: str
    plan: Plan
    truth: Truth
    push: tuple[float, float, float]
    gusts: float
    start: Four
    seed: int


def belief_of(kind: str, delay: float, doubt: float) -> Belief:
    """What is believed of a kind: as from a card, with that delay."""
    g, b, sd = KINDS[kind]
    table = np.array([[g, b, delay], [g, b, delay], [2.9, 2.9, delay], [3.2, 3.2, delay]])
    spread = [(sd, b), (sd, b), (0.8, 2.9), (1.4, 3.2)]
    covariance = np.zeros((12, 12))
    for a, ((one, damping), (input_, *_)) in enumerate(zip(spread, table, strict=True)):
        share = one / damping if kind == "velocity" or a > 1 else 0.0  # of a velocity loop, input over damping is known
        at = slice(3 * a, 3 * a + 2)
        covariance[at, at] = [
            [input_**2 * (share**2 + 0.15**2), input_ * one * share],
            [input_ * one * share, one**2],
        ]
        covariance[3 * a + 2, 3 * a + 2] = doubt**2
    gamma = tuple(map(float, table[:, :2].ravel()))
    return Belief(Truth(gamma=gamma, delay=(delay,) * 4), covariance, (0.05, 0.05, 0.03, 0.02))


def cases(count: int, seed: int) -> Iterator[Case]:
    """Vehicles of the whole family, from 2 to 3 m away, by a seed."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        kind = list(KINDS)[number % 3]
        belief = belief_of(kind, *DELAYS[number // 3 % 3])
        (truth,) = sample_vehicles(belief, 1, int(rng.integers(2**31)))
        b = KINDS[kind][1]
        strength = (b if kind != "acceleration" else 1.0) * WIND * float(rng.choice([0.0, 0.0, 1.0]))
        angle, away = rng.uniform(-math.pi, math.pi, 2)
        distance, up = rng.uniform(2.0, 3.0), rng.uniform(-0.5, 0.5)
        flat = math.sqrt(distance**2 - up**2)
        at = SPACE.start
        start = at[0] + flat * math.cos(away), at[1] + flat * math.sin(away), at[2] + up, rng.uniform(-1.0, 1.0)
        wide = replace(SPACE, lower=(-6.0, -6.0, 0.2), upper=(6.0, 6.0, 5.0))
        plan = Plan("test", "two_sines", CARD.raw, 50.0, 1.0, 0.0, (), None, wide, belief_mapping(belief))
        delay = tuple(min(each, LONGEST) for each in truth.delay)
        gamma = tuple(max(g, SLOWEST) for g in truth.gamma)
        push = strength * math.cos(angle), strength * math.sin(angle), 0.0
        yield Case(
            kind,
            plan,
            replace(truth, gamma=gamma, delay=delay),
            push,
            float(rng.choice([0.02, 0.04])),
            start,
            number,  # type: ignore[arg-type]
        )


class BelievedVehicle:
    """The vehicle of a case as a link."""

    live, fail_safe, silence, undone = False, "", Silence(), ""

    def __init__(self, case: Case) -> None:
        self._truth, self._push, self._gusts = case.truth, np.array([*case.push, 0.0]), case.gusts
        self._rng = np.random.default_rng(case.seed)
        self._pose, self._speed = np.array(case.start), np.zeros(4)
        self._acting, self._gust = np.zeros(4), np.zeros(4)
        self._sent: list[tuple[int, Array]] = [(0, np.zeros(4))]
        self._step = self._next = 0
        self.path: list[Array] = []

    @property
    def now(self) -> int:
        return round(self._step * STEP * 1e9)

    def send(self, command: Sequence[float]) -> Sequence[float]:
        self._sent.append((self._step, np.array(command)))
        return command

    def act(self, action: Action) -> None:
        """Nothing is to be done."""

    def receive(self, until: int) -> list[Sample]:
        found = []
        while self.now < until:
            if self._step >= self._next:  # 100 poses a second
                self._next = self._step + 2
                found.append(self._seen())
            self._move()
        return found

    def _seen(self) -> Sample:
        self.path.append(self._pose.copy())
        x, y, z, yaw = (self._pose + 0.001 * self._rng.standard_normal(4)).tolist()
        return Sample("pose", self.now, self.now, (x, y, z, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))

    def _move(self) -> None:
        told = np.array([self._told(a) for a in range(4)])
        self._acting += STEP / LAG * (told - self._acting)
        fade = math.exp(-STEP / GUST_TIME)
        self._gust = fade * self._gust + self._gusts * math.sqrt(1 - fade**2) * self._rng.standard_normal(4)
        gamma, c, s = np.array(self._truth.gamma), math.cos(self._pose[3]), math.sin(self._pose[3])
        turn = np.eye(4)
        turn[:2, :2] = [[c, -s], [s, c]]
        force = gamma[::2] * self._acting - gamma[1::2] * (turn.T @ self._speed) + np.array(self._truth.trim)
        self._speed += STEP * (turn @ force + self._push + self._gust * (1, 1, 1, 0.4))
        self._pose += STEP * self._speed
        self._step += 1

    def _told(self, axis: int) -> float:
        """The command that acts on an axis now."""
        acts = self._step - round(self._truth.delay[axis] / STEP)
        return next((float(command[axis]) for sent, command in reversed(self._sent) if sent <= acts), 0.0)


def approached(case: Case, path: Path) -> tuple[str, float, float, float]:
    """Flies to the start.

    Returns:
        How it ended; distance then [m]; how far beyond the start it has been, along the line to it [m]; time [s].
    """
    link = BelievedVehicle(case)
    result = flown(link, path, case.plan, land=False)
    log = read(path)
    begun = next((event.time for event in log.events if event.text == "plan begins"), log.events[-1].time)
    way = np.array(link.path)[: round(begun / 1e9 * 100), :3]
    start, line = np.array(case.plan.space.start[:3]), np.array(case.plan.space.start[:3]) - np.array(case.start[:3])
    beyond = (way - start) @ (line / np.linalg.norm(line))
    return result.reason, float(np.linalg.norm(way[-1] - start)), float(beyond.max()), begun / 1e9
