"""The window of a card, live: as in a log, a state holds from its message on, and events open and close."""

from typing import Any

import pytest

from rotorfit.core.errors import LinkError
from rotorfit.files.cards import builtin_cards, card_from_mapping
from rotorfit.flying.links.card_window import Obedience, obedience


def window(*conditions: dict[str, Any]) -> Obedience:
    return obedience(card_from_mapping({**builtin_cards()["bebop2"].raw, "window": list(conditions)}, "bebop2"))


def told(asked: Obedience, *values: float, table: str = "/state") -> list[float]:
    """What is told at the beginning and of each message in turn."""
    samples = asked.begun(0)
    for value in values:
        samples += asked.heard(table, lambda _, value=value: value, 1)  # type: ignore[misc]
    return [one.values[0] for one in samples]


@pytest.mark.parametrize(
    ("condition", "values", "said"),
    [
        ({}, (0.0, 1.0, 2.0, 0.0), [0.0, 1.0, 0.0]),
        ({"equals": [4, 5]}, (3.0, 4.0, 5.0, 6.0), [0.0, 1.0, 0.0]),
        ({"above": 0.3}, (0.2, 0.31, float("nan")), [0.0, 1.0, 0.0]),
        ({"opens": 28, "closes": [11, 18]}, (99.0, 28.0, 18.0, 99.0, 28.0), [1.0, 0.0, 1.0]),
        ({"optional": True}, (0.0, 1.0), [1.0, 0.0, 1.0]),
    ],
)
def test_each_kind_of_condition(condition: dict[str, Any], values: tuple[float, ...], said: list[float]) -> None:
    assert told(window({"when": "/state:x", **condition}), *values) == said


def test_all_conditions_and_the_vehicle_itself_must_agree() -> None:
    asked = window({"when": "/state:x"}, {"when": "/range:height", "above": 0.3})

    assert told(asked, 1.0) == [0.0]
    assert told(asked, 0.5, table="/range") == [1.0]
    assert [one.values for one in asked.reported(False, 2)] == [(0.0,)]
    assert told(asked, 2.0) == []
    assert [one.values for one in asked.reported(True, 2)] == [(1.0,)]


def test_scale_and_unit_come_before_the_condition() -> None:
    assert told(window({"when": {"from": "/state:x", "unit": "mm"}, "above": 0.3}), 299.0, 301.0) == [0.0, 1.0]


def test_without_a_window_nothing_is_said_before_there_is_anything_to_say() -> None:
    asked = window()

    assert told(asked, 0.0) == []
    assert [one.values for one in asked.reported(True, 1)] == [(1.0,)]


def test_a_condition_without_a_message_is_refused() -> None:
    with pytest.raises(LinkError, match="a link needs a message"):
        window({"when": "mode"})
