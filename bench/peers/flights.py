"""Training and test flights: recorded ones where available, and simulated ones for everybody."""

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.log import Log
from rotorfit.dynamics.protocol import AxisDynamics
from rotorfit.files.cards import load_card
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import GAMMA_A, GAMMA_E, Controller, Truth, as_log, simulate_flight

REAL_FLIGHTS = Path(__file__).resolve().parents[3] / "shared" / "data"

NO_TRIM = 1e-8
"""Variance of the trim of a simulated vehicle, which has none [m^2/s^4]; the filter needs more than 0."""

Span = tuple[float | None, float | None]
Maker = Callable[[], tuple[list[Flight], list[Flight]]]


@dataclass(frozen=True)
class Case:
    """One set: what trains, what tests.

    Attributes:
        name: As printed.
        axes: Those that may be scored; of them, those for which rotorfit finds a model.
        make: Training and test flights.
        kind: `recorded` or `simulated`.
        truth: Of a simulated vehicle, in the wind that it flew in: what nobody who knows only the past should beat.
    """

    name: str
    axes: tuple[str, ...]
    make: Maker
    kind: str = "recorded"
    truth: Mapping[str, AxisDynamics] = field(default_factory=dict)


@functools.cache
def log_of(name: str) -> Log:
    return read(REAL_FLIGHTS / name)


def recorded(training: Sequence[tuple[str, Span]], test: Sequence[tuple[str, Span]]) -> Maker:
    """Spans of files, read with the card beside them."""

    def make() -> tuple[list[Flight], list[Flight]]:
        both = [
            [
                flight_from_log(log_of(name), load_card(str(REAL_FLIGHTS / Path(name).parent / "card.toml")), span)
                for name, span in part
            ]
            for part in (training, test)
        ]
        return both[0], both[1]

    return make


def halves(name: str, at: float, *, backwards: bool) -> Maker:
    first, second = [(name, (None, at))], [(name, (at, None))]
    return recorded(second, first) if backwards else recorded(first, second)


def real_cases() -> Iterator[Case]:
    """Sets of recorded flights; none where the folder is absent."""
    if not REAL_FLIGHTS.is_dir():
        return
    for axis, at in (("x", 84.0), ("z", 68.0)):
        name = f"bebop2-wsu/Training_CT_TestDay_{axis.upper()}.mat"
        for backwards, way in ((False, "1st half -> 2nd"), (True, "2nd half -> 1st")):
            make = halves(name, at, backwards=backwards)
            yield Case(f"bebop2-wsu {axis.upper()}, {way}", (axis,), make)
    for manoeuvre, axis in (("pitch", "x"), ("vert", "z")):
        bags = [[(f"bebop2-optitrack/monster_{manoeuvre}_{part}.bag", (None, None))] for part in ("trn", "tst")]
        yield Case(f"bebop2-optitrack {manoeuvre}, train -> test", (axis,), recorded(*bags))
    dji = [(f"dji-hexarotor/Datos_Prueba{i}.mat", (None, None)) for i in range(1, 7)]
    yield Case("dji-hexarotor, 1-4 -> 5, 6", AXES, recorded(dji[:4], dji[4:]))
    for backwards, way in ((False, "1st half -> 2nd"), (True, "2nd half -> 1st")):
        make = halves("bebop2-joystick/record_velocity.csv", 35.0, backwards=backwards)
        yield Case(f"bebop2-joystick, {way}", AXES, make)
    names = {
        "z": ("ZDOT_02_Feb_2022_10_39_58_LARANJA_COMPLETO", "ZDOT_02_Feb_2022_10_43_56_LARANJA_COMPLETO_bonito"),
        "yaw": ("PSIDOT_02_Feb_2022_10_55_15_LARANJA_COMPLETO", "PSIDOT_02_Feb_2022_11_03_43_LARANJA_COMPLETO"),
    }
    for axis, pair in names.items():
        files = [[(f"ardrone2-optitrack/{name}.mat", (None, None))] for name in pair]
        yield Case(f"ardrone2-optitrack {axis}", (axis,), recorded(*files))


def random_steps(t: Array, seed: int, amplitude: Sequence[float]) -> Array:
    """Commands of -1, 0 or 1 times the amplitude of each axis, switched at random every 0.4 to 2 s; shape (N, 4)."""
    rng = np.random.default_rng(seed)
    level = rng.integers(-1, 2, (400, 4)) * np.asarray(amplitude)
    switch = np.cumsum(0.4 + 1.6 * rng.random((400, 4)), axis=0)
    return np.stack([level[np.searchsorted(switch[:, k], t), k] for k in range(4)], axis=-1)


def simulated(
    name: str,
    axes: tuple[str, ...],
    truth: Truth,
    excite: Callable[[int], Callable[[Array], Array]],
    length: float,
    seed: int,
    controller: Controller | None = None,
) -> Case:
    """Training flight with `seed`, test flight with `seed` + 1."""

    def make() -> tuple[list[Flight], list[Flight]]:
        card = load_card("rotorfit-demo")
        both = [
            flight_from_log(as_log(simulate_flight(truth, excite(s), length, s, controller=controller)), card)
            for s in (seed, seed + 1)
        ]
        return both[:1], both[1:]

    return Case(f"simulated, {name}, seeds {seed}, {seed + 1}", axes, make, "simulated", dynamics_of(truth))


def dynamics_of(truth: Truth) -> dict[str, AxisDynamics]:
    """The vehicle and its wind in the parameters of the filter: wind of rate 1 / T passes the damping b."""
    out = {}
    for k, axis in enumerate(AXES):
        b, rate = truth.gamma[2 * k + 1], 1 / truth.wind_time[k]
        power, noise = 2 * truth.wind_sigma[k] ** 2 * rate, truth.mocap_noise[k] ** 2
        levels = (power, noise, b + rate, 4 * b * rate / (b + rate) ** 2)
        out[axis] = AxisDynamics(truth.gamma[2 * k], b, truth.delay[k], levels, NO_TRIM)
    return out


def simulated_cases() -> Iterator[Case]:
    """Three rooms: the paper's two sines; steps on all axes while turning; a weak vehicle held in place in wind."""

    def sines(_: int) -> Callable[[Array], Array]:
        return functools.partial(two_sines, axes=("x", "y"))

    def steps(amplitude: Sequence[float]) -> Callable[[int], Callable[[Array], Array]]:
        return lambda seed: functools.partial(random_steps, seed=seed, amplitude=amplitude)

    yield simulated("set B, two sines on x and y", ("x", "y"), Truth(), sines, 100.0, 31)
    windy = replace(Truth(), gamma=GAMMA_A, wind_sigma=(0.1, 0.1, 0.1, 0.05), delay=(0.25, 0.25, 0.15, 0.1))
    yield simulated("set A, steps on all axes, windy", AXES, windy, steps((0.4, 0.4, 0.4, 0.2)), 60.0, 41)
    held = replace(Truth(), gamma=GAMMA_E, wind_sigma=(0.1, 0.1, 0.1, 0.02), mocap_noise=(0.002, 0.002, 0.002, 0.003))
    sets = ("set E, steps, held in place, windy, 2 mm", ("x", "y", "z"))
    yield simulated(*sets, held, steps((0.3, 0.3, 0.3, 0.0)), 100.0, 51, Controller())
