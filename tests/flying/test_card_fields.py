"""What a card says of a live link: sending inverts reading, frames and signs come out right."""

import math
from typing import Any

import numpy as np
import pytest

from rotorfit.core.errors import LinkError
from rotorfit.core.frames import yaw_from_quaternion
from rotorfit.files.cards import builtin_cards, card_from_mapping
from rotorfit.flying.links.card_fields import command_fields, enu_from_ned, pose_fields, pose_values, raw_values


def card(**changes: Any) -> Any:
    raw = {
        "name": "a drone",
        "command": {
            "time": "/cmd:log_time",
            "x": {"from": "/cmd:f", "scale": -0.5, "offset": 0.25},
            "y": "/cmd:l",
            "z": {"from": "/cmd:u", "unit": "cm/s"},
            "yaw": {"from": "/cmd:r", "scale": -1, "unit": "deg/s"},
        },
        "pose": {"time": "/pose:header.stamp", "x": "/pose:x", "y": "/pose:y", "z": "/pose:z", "yaw": "/pose:yaw"},
    }
    for section, change in changes.items():
        raw[section] = raw.get(section, {}) | change if isinstance(change, dict) else change
    return card_from_mapping(raw, "test")


def test_sending_is_the_inverse_of_reading() -> None:
    raw = raw_values(command_fields(card()), (1.0, 0.5, 0.3, math.pi))

    assert raw == pytest.approx({"f": -1.5, "l": 0.5, "u": 30.0, "r": -180.0})
    assert -0.5 * raw["f"] + 0.25 == pytest.approx(1.0)  # what a log under this card would hold


def test_hover_is_the_raw_value_that_reads_as_zero() -> None:
    assert raw_values(command_fields(card()), (0.0, 0.0, 0.0, 0.0))["f"] == pytest.approx(0.5)


def test_a_command_on_an_axis_that_the_card_does_not_command_is_refused() -> None:
    raw = {"command": {"time": "/c:t", "x": "/c:x"}, "pose": card().raw["pose"]}
    fields = command_fields(card_from_mapping(raw, "one axis"))

    assert raw_values(fields, (0.1, 0.0, 0.0, 0.0)) == {"x": 0.1}
    with pytest.raises(LinkError, match="a command on z, which the card does not command"):
        raw_values(fields, (0.1, 0.0, 0.2, 0.0))


def test_commands_along_the_world_axes_are_refused() -> None:
    with pytest.raises(LinkError, match="along the world axes"):
        command_fields(card(command={"frame": "world"}))


@pytest.mark.parametrize("column", ["/other:l", "l"])
def test_commands_of_several_messages_are_refused(column: str) -> None:
    with pytest.raises(LinkError, match="all channels in one message"):
        command_fields(card(command={"y": column}))


def test_a_pose_is_read_with_scale_unit_and_constants() -> None:
    fields = pose_fields(card(pose={"x": {"from": "/pose:x", "unit": "mm"}, "z": 1.2}))

    values = pose_values(fields, {"x": 500.0, "y": -2.0, "yaw": math.pi / 2}.__getitem__)

    assert values == pytest.approx((0.5, -2.0, 1.2, math.sqrt(0.5), 0, 0, math.sqrt(0.5)))


def test_a_pose_with_a_number_that_is_not_finite_is_no_pose() -> None:
    assert pose_values(pose_fields(card()), {"x": math.nan, "y": 0.0, "z": 0.0, "yaw": 0.0}.__getitem__) is None


def test_a_card_in_ned_is_turned_to_z_up_and_counter_clockwise() -> None:
    values = pose_values(pose_fields(card(frame="NED")), {"x": 1.0, "y": 2.0, "z": -3.0, "yaw": 0.3}.__getitem__)

    assert values is not None
    assert values[:3] == (2.0, 1.0, 3.0)
    assert float(yaw_from_quaternion(*np.array(values[3:]))) == pytest.approx(math.pi / 2 - 0.3)


def rotation(q: tuple[float, ...]) -> np.ndarray[Any, Any]:
    w, x, y, z = q
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def test_the_attitude_from_ned_turns_every_body_vector_to_where_it_points() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        q = rng.standard_normal(4)
        q /= np.linalg.norm(q)
        forward_left_up = rng.standard_normal(3)
        ned = rotation(tuple(q)) @ (forward_left_up * [1, -1, -1])

        turned = rotation(enu_from_ned((0.0, 0.0, 0.0), tuple(q))[3:]) @ forward_left_up

        np.testing.assert_allclose(turned, [ned[1], ned[0], -ned[2]], atol=1e-12)


@pytest.mark.parametrize(
    "name", ["bebop2", "bebop2-odometry", "bebop2-drone-dev", "bebop2-optitrack", "tello", "mavlink"]
)
def test_forward_is_forward_and_left_is_left_on_the_built_in_cards(name: str) -> None:
    fields = command_fields(builtin_cards()[name])

    raw = [raw_values(fields, tuple(0.5 * (k == axis) for k in range(4))) for axis in range(4)]

    left_up_signs = {"tello": (1, -1, 1, -1), "mavlink": (1, -1, -1, -1)}.get(name, (1, 1, 1, 1))
    for axis, (values, sign) in enumerate(zip(raw, left_up_signs, strict=True)):
        channel = list(fields.channels.values())[axis]
        assert np.sign(values.pop(str(channel.source))) == sign
        assert not any(values.values())
