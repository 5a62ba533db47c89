import pytest

from rotorfit.core.errors import nearest


@pytest.mark.parametrize(
    ("name", "offered"),
    [
        ("tild", "tilt"),
        ("TILT", "tilt"),
        ("yaw-rate", "yaw_rate"),
        ("zzz", ""),
        ("plan.toml", ""),
        ("", ""),
    ],
)
def test_a_known_name_is_offered_only_for_one_that_is_like_it(name: str, offered: str) -> None:
    told = nearest(name, ["tilt", "yaw_rate", "speed", "z"])

    assert told == (f"; nearest: {offered!r}" if offered else "")
