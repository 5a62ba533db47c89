"""Vehicles: what their files say, what is refused, and the linear truth against a second way to it."""

import math
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rotorfit.core.errors import VehicleError
from rotorfit.core.limits import expectation, meaning_of
from rotorfit.files.cards import card_from_mapping
from rotorfit.simulation.paper_vehicle import GAMMA_B
from rotorfit.simulation.vehicle import Radio, Vehicle, builtin_vehicles, load_vehicle, vehicle_from_mapping

NAMES = ("ardrone2", "bebop2", "crazyflie", "m100", "tello")


def text_of(name: str) -> str:
    return resources.files("rotorfit.simulation").joinpath("vehicles", f"{name}.toml").read_text(encoding="utf-8")


def raw_of(name: str = "bebop2") -> dict[str, Any]:
    return tomllib.loads(text_of(name))


def test_five_vehicles_ship() -> None:
    assert tuple(builtin_vehicles()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_figure_of_a_vehicle_says_where_it_comes_from(name: str) -> None:
    figures = [
        line
        for line in text_of(name).splitlines()
        if "=" in line and line.partition("=")[2].strip()[0] in "[0123456789"
    ]

    assert len(figures) > 25
    assert [line for line in figures if "#" not in line] == []


def test_the_bebop_2_comes_near_published_set_b() -> None:
    linear = load_vehicle("bebop2").linear()

    x, y = (np.array(linear.gamma[k : k + 2]) for k in (0, 2))
    assert x == pytest.approx(GAMMA_B[0:2], rel=0.02)
    assert y == pytest.approx(GAMMA_B[2:4], rel=0.05)
    assert linear.gamma[4:] == pytest.approx(GAMMA_B[4:], rel=0.01)
    assert all(0.15 <= delay <= 0.20 for delay in linear.delay[:2])


@pytest.mark.parametrize("name", NAMES)
def test_a_vehicles_card_is_a_card_and_expects_what_the_vehicle_does(name: str) -> None:
    vehicle = load_vehicle(name)
    card, gamma = card_from_mapping(vehicle.card(), name), vehicle.linear().gamma

    expected = {axis: expectation(meaning_of(card, axis)) for axis in ("x", "y", "z", "yaw")}
    assert None not in expected.values()
    for k, axis in enumerate(expected):
        tilts = meaning_of(card, axis).asked == "tilt"
        reached = gamma[2 * k] if tilts else gamma[2 * k] / gamma[2 * k + 1]
        assert reached == pytest.approx(expected[axis], rel=0.2), axis  # drag keeps a speed servo below what is asked


def lags(response: Callable[[complex], complex]) -> tuple[float, float, float]:
    """Gain, mean and variance of an impulse response, by differences of its transform near 0."""
    h = 1e-3
    low, middle, high = (np.log(response(s)).real for s in (-h, 0.0, h))
    return float(np.exp(middle)), (low - high) / (2 * h), (low - 2 * middle + high) / h**2


@pytest.mark.parametrize("name", NAMES)
def test_the_linear_truth_has_gain_mean_lag_and_spread_of_the_loops(name: str) -> None:
    vehicle = load_vehicle(name)
    linear, attitude, rotor = vehicle.linear(), vehicle.attitude, vehicle.rotors.time_constant
    latency, scale = vehicle.radio.latency + vehicle.radio.jitter, vehicle.full_scale()

    def tilt(s: complex) -> complex:
        rate = 2 * attitude.damping * attitude.frequency / (s * (rotor * s + 1))
        rate = rate / (1 + rate)
        turn = attitude.frequency / (2 * attitude.damping) * rate / s
        return turn / (1 + turn)

    def loop(
        gain: float, drag: float, inner: Callable[[complex], complex], asks_tilt: bool
    ) -> Callable[[complex], complex]:
        if asks_tilt:
            return lambda s: np.exp(-latency * s) * 9.81 * inner(s) / (s + drag)
        return lambda s: np.exp(-latency * s) * gain * inner(s) / (s + drag + gain * inner(s))

    rotors = lambda s: 1 / (rotor * s + 1)  # noqa: E731
    tilts, gains = vehicle.command.horizontal == "tilt", vehicle.loops
    axes = (
        loop(gains.velocity, vehicle.drag[0], tilt, tilts),
        loop(gains.velocity, vehicle.drag[1], tilt, tilts),
        loop(gains.climb, vehicle.drag[2], rotors, False),
        loop(gains.yaw, 0.0, rotors, False),
    )
    for k, axis in enumerate(axes):
        gain, mean, variance = lags(lambda s, axis=axis: axis(s + 1e-9))  # type: ignore[misc]
        g, d, delay = linear.gamma[2 * k], linear.gamma[2 * k + 1], linear.delay[k]
        assert g / d == pytest.approx(gain * scale[k], rel=1e-3)
        assert delay + 1 / d == pytest.approx(mean, rel=1e-3)
        assert 1 / d == pytest.approx(np.sqrt(variance), rel=2e-2)


def test_another_radio_moves_the_delays_and_nothing_else() -> None:
    vehicle = load_vehicle("bebop2")
    quick = vehicle.linear(Radio(0.0))

    assert quick.gamma == vehicle.linear().gamma
    assert np.array(vehicle.linear().delay) - np.array(quick.delay) == pytest.approx(0.045)


def changed(change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    raw = raw_of()
    change(raw)
    return raw


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda raw: raw.update(mas=1.0), "unknown key 'mas'; nearest: 'mass'"),
        (lambda raw: raw["rotors"].update(arms=1.0), "nearest: 'arm'"),
        (lambda raw: raw.pop("mass"), "mass is missing"),
        (lambda raw: raw["radio"].pop("latency"), "radio: latency is missing"),
        (lambda raw: raw.update(mass="heavy"), "must be a number"),
        (lambda raw: raw.update(mass=-1.0), "not negative"),
        (lambda raw: raw.update(mass=0.0), "must be positive"),
        (lambda raw: raw["odometry"].update(rate=math.inf), "rate: must be finite; only land_after and learning"),
        (lambda raw: raw["radio"].update(latency=math.inf), "latency: must be finite"),
        (lambda raw: raw.update(drag=[0.1, 0.2]), "must be 3 numbers"),
        (lambda raw: raw.update(rotors=3), "must be a section"),
        (lambda raw: raw["autopilot"].update(brakes_on_zero=1), "true or false"),
        (lambda raw: raw["command"].update(horizontal="thrust"), "'thrust' is not one of tilt, velocity"),
        (lambda raw: raw["command"].update(horizontal="velocity"), "speed is missing"),
        (lambda raw: raw.update(mass=2.0), "must hold the weight"),
        (lambda raw: raw["rotors"].update(time_constant=0.2), "unstable"),
        (
            lambda raw: raw["command"].update(horizontal="velocity", speed=1.0) or raw["loops"].update(velocity=8.0),
            "overshoots",
        ),
    ],
)
def test_what_cannot_be_a_vehicle_is_refused_in_one_line(
    change: Callable[[dict[str, Any]], object], words: str
) -> None:
    with pytest.raises(VehicleError) as caught:
        vehicle_from_mapping(changed(change), "mine.toml")

    assert words in str(caught.value)
    assert str(caught.value).count("\n") == 0


def test_a_vehicle_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text_of("bebop2").replace('"Parrot Bebop 2"', '"Mine"'))

    assert load_vehicle(str(path)).name == "Mine"


def test_an_unknown_name_lists_the_known_ones_and_no_toml_says_so(tmp_path: Path) -> None:
    with pytest.raises(VehicleError, match="bebop2, crazyflie"):
        load_vehicle("bebop3")
    (tmp_path / "broken.toml").write_text("mass =")
    with pytest.raises(VehicleError, match="not readable as TOML"):
        load_vehicle(str(tmp_path / "broken.toml"))


def test_the_card_of_a_fraction_vehicle_names_limits_and_that_of_an_si_vehicle_commands_in_si() -> None:
    def channel(vehicle: Vehicle) -> dict[str, Any]:
        return dict(vehicle.card()["command"]["x"])

    assert channel(load_vehicle("bebop2"))["full_scale"] == "tilt"
    assert channel(load_vehicle("tello"))["full_scale"] == "speed"
    assert "full_scale" not in channel(load_vehicle("m100"))
