"""What commands mean by their card, what is expected of them, limits as text, and the published sets."""

import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError
from rotorfit.core.frames import AXES
from rotorfit.core.limits import (
    command_of,
    expectation,
    gain_factor,
    limit_text,
    limit_that_gives,
    limits_from_text,
    meaning_of,
)
from rotorfit.files.cards import builtin_cards, card_from_mapping
from rotorfit.simulation.published import PUBLISHED, sets_for, vehicle_of

SETTINGS = (Path(__file__).resolve().parents[2] / "docs" / "settings.md").read_text(encoding="utf-8")
DEG = math.pi / 180


def card_of(limits: str = "", **channels: str) -> Card:
    """A card whose commands are these TOML inline tables, under these limits."""
    commands = "\n".join(f"{axis} = {{ from = 'c:{axis}', {text} }}" for axis, text in channels.items())
    text = (
        f"[command]\ntime = 'c:t'\n{commands}\n[pose]\ntime = 'p:t'\nx = 'p:x'\ny = 'p:y'\nz = 'p:z'\nyaw = 'p:yaw'\n"
    )
    return card_from_mapping(tomllib.loads(f"{text}[limits]\n{limits}"), "test")


# Meaning


@pytest.mark.parametrize(
    ("axis", "channel", "asked", "limit"),
    [
        ("x", "meaning = 'tilt', full_scale = 'tilt'", "tilt", "tilt"),
        ("x", "full_scale = 'tilt'", "tilt", "tilt"),
        ("y", "meaning = 'tilt'", "tilt", None),
        ("y", "unit = 'deg'", "tilt", None),
        ("x", "unit = 'cm/s'", "velocity", None),
        ("x", "full_scale = 'speed'", "velocity", "speed"),
        ("z", "meaning = 'vertical_speed', full_scale = 'vertical_speed'", "vertical_speed", "vertical_speed"),
        ("z", "meaning = 'velocity', unit = 'm/s'", "velocity", None),
        ("yaw", "unit = 'deg/s'", "yaw_rate", None),
        ("yaw", "full_scale = 'yaw_rate'", "yaw_rate", "yaw_rate"),
    ],
)
def test_meaning_is_read_from_meaning_full_scale_or_unit(axis: str, channel: str, asked: str, limit: str) -> None:
    meaning = meaning_of(card_of("tilt = 0.3\nspeed = 2.0", **{axis: channel}), axis)

    assert (meaning.asked, meaning.limit, meaning.reason) == (asked, limit, None)
    assert meaning.setting == {"tilt": 0.3, "speed": 2.0}.get(limit or "")


@pytest.mark.parametrize(
    ("axis", "channel", "why"),
    [
        ("x", "scale = -1", "does not say"),
        ("z", "meaning = 'tilt'", "does not move z"),
        ("yaw", "meaning = 'velocity'", "does not move yaw"),
        ("x", "meaning = 'tilt', full_scale = 'yaw_rate'", "contradicts itself"),
        ("x", "meaning = 'tilt', unit = 'm/s'", "contradicts itself"),
        ("x", "meaning = 'tilt', full_scale = 'tilt', unit = 'deg'", "contradicts itself"),
        ("x", "unit = 's'", "does not say"),
    ],
)
def test_what_a_card_leaves_open_or_contradicts_is_a_reason_and_no_guess(axis: str, channel: str, why: str) -> None:
    meaning = meaning_of(card_of(**{axis: channel}), axis)

    assert meaning.asked is None
    assert meaning.limit is None
    assert why in (meaning.reason or "")
    assert expectation(meaning) is None


def test_an_axis_without_a_command_has_no_meaning() -> None:
    assert "no command for yaw" in (meaning_of(card_of(x="meaning = 'tilt'"), "yaw").reason or "")


def test_what_is_expected_of_a_command_of_one() -> None:
    limits = "tilt = { value = 20, unit = 'deg' }\nvertical_speed = 1.2\nyaw_rate = { value = 100, unit = 'deg/s' }"
    card = card_of(limits, x="full_scale = 'tilt'", y="meaning = 'tilt'", z="full_scale = 'vertical_speed'",
                   yaw="full_scale = 'yaw_rate'")  # fmt: skip
    found = [expectation(meaning_of(card, axis)) for axis in AXES]

    assert found == pytest.approx([9.81 * 0.36397, 9.81, 1.2, 1.74533], rel=1e-5)
    assert expectation(meaning_of(card_of(x="full_scale = 'tilt'"), "x")) is None
    assert expectation(meaning_of(card_of(x="unit = 'm/s'"), "x")) == 1.0


@pytest.mark.parametrize("limit", ["tilt", "vertical_speed", "yaw_rate", "speed"])
def test_the_limit_that_gives_undoes_the_expectation_and_the_factor_is_a_ratio_of_expectations(limit: str) -> None:
    axis = {"tilt": "x", "speed": "x", "vertical_speed": "z", "yaw_rate": "yaw"}[limit]
    one, other = (meaning_of(card_of(f"{limit} = {s}", **{axis: f"full_scale = '{limit}'"}), axis) for s in (0.2, 0.7))
    a, b = expectation(one), expectation(other)
    assert a is not None
    assert b is not None

    assert limit_that_gives(one, a) == pytest.approx(0.2, rel=1e-14)
    assert gain_factor(limit, 0.2, 0.7) == pytest.approx(b / a, rel=1e-14)


def test_every_built_in_card_means_something_consistent() -> None:
    for name, card in builtin_cards().items():
        for axis in card.command:
            assert meaning_of(card, axis).asked, f"{name}: {meaning_of(card, axis).reason}"


# Limits


def test_limits_are_read_from_text_as_a_card_has_them() -> None:
    assert limits_from_text("tilt=20deg, vertical_speed = 2,yaw_rate=1.5e2 deg/s") == {
        "tilt": {"value": 20.0, "unit": "deg"},
        "vertical_speed": 2.0,
        "yaw_rate": {"value": 150.0, "unit": "deg/s"},
    }


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("tild=20deg", "nearest: 'tilt'"),
        ("climb=2", "no limit 'climb'"),
        ("tilt", "not NAME=NUMBER"),
        ("tilt=fast", "not NAME=NUMBER"),
        ("", "not NAME=NUMBER"),
        ("tilt=10deg,", "not NAME=NUMBER"),
        ("tilt=10deg,tilt=20deg", "given twice"),
    ],
)
def test_a_text_that_is_no_limit_is_refused_in_one_line(text: str, why: str) -> None:
    with pytest.raises(CardError, match=re.escape(why)) as error:
        limits_from_text(text)
    assert "\n" not in str(error.value)


def test_limits_are_told_in_the_units_of_people() -> None:
    assert [limit_text("tilt", 20 * DEG), limit_text("yaw_rate", 100 * DEG), limit_text("speed", 2.5)] == [
        "20 deg", "100 deg/s", "2.5 m/s",
    ]  # fmt: skip


@pytest.mark.parametrize("value", ["1.6", "20", "{ value = 90, unit = 'deg' }"])
def test_a_card_refuses_a_tilt_of_ninety_degrees_or_more(value: str) -> None:
    with pytest.raises(CardError, match="no tilt below 90 deg"):
        card_of(f"tilt = {value}", x="meaning = 'tilt'")


# Published sets


def test_every_published_set_has_eight_coefficients_a_source_and_a_vehicle_that_finds_it() -> None:
    assert len({known.name for known in PUBLISHED}) == len(PUBLISHED) == 8
    for known in PUBLISHED:
        assert len(known.gamma) == 8
        assert known.source
        assert known in sets_for(known.vehicle)


@pytest.mark.parametrize(
    ("name", "vehicle"),
    [
        ("Parrot Bebop 2, bebop_autonomy and Vicon", "Bebop 2"),
        ("my bebop2", "Bebop 2"),
        ("Parrot Bebop, lab", "Bebop 1"),
        ("Parrot AR.Drone 2, OptiTrack", "AR.Drone 2"),
        ("ardrone2", "AR.Drone 2"),
        ("rotorfit demo quadrotor", None),
        ("DJI hexarotor, velocity mode", None),
    ],
)
def test_the_vehicle_is_known_by_the_name_of_the_card(name: str, vehicle: str | None) -> None:
    assert vehicle_of(name) == vehicle


def test_the_worked_example_of_the_documents_is_right() -> None:
    gamma = {known.name: known.gamma for known in PUBLISHED}
    rows = re.findall(r"^\| (\w+|the paper), .*?\| ([\d.]+) \| ([\d.]+) \| ([\d.]+) deg \| ([\d.]+) deg \|$", SETTINGS,
                      re.MULTILINE)  # fmt: skip
    assert len(rows) == 5
    for name, *cells in rows:
        x, y = gamma["paper" if name == "the paper" else name][:3:2]
        assert x is not None
        assert y is not None
        told = [float(cell) for cell in cells]
        assert told[:2] == pytest.approx([x, y], abs=6e-4)
        assert told[2:] == pytest.approx([np.degrees(np.arctan(g / 9.81)) for g in (x, y)], abs=0.051)
    assert 0.8417 * gain_factor("tilt", 5 * DEG, 20 * DEG) == pytest.approx(3.50, abs=0.005)
    assert "tan(20 deg) / tan(5 deg) = 3.50" in SETTINGS


@pytest.mark.parametrize(
    ("channel", "held"),
    [
        ("scale = 1", ""),
        ("scale = -1", "; c:x of the log is it times -1"),
        ("unit = 'deg', meaning = 'tilt'", "; c:x of the log is it times 57.2958"),
        ("scale = 0.002, offset = -3", "; c:x of the log is it times 500 plus 1500"),
    ],
)
def test_a_command_that_the_log_holds_as_another_number_says_how(channel: str, held: str) -> None:
    text = command_of(card_of(x=channel), "x").text

    assert text.endswith(held) if held else "of the log" not in text


def test_physical_commands_are_held_as_the_fractions_of_the_log() -> None:
    card = card_of("tilt = { value = 20, unit = 'deg' }", x="scale = -0.01, full_scale = 'tilt'")

    assert command_of(card, "x").text.endswith("from -1 to 1; c:x of the log is it times -100")
    physical = command_of(card, "x", physical=True).text
    assert physical.endswith(f"c:x of the log is it times {-100 / (20 * DEG):.6g}")
