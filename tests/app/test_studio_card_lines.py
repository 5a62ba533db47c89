"""One value of a card's text is changed; everything else stays as its author wrote it."""

import tomllib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorfit.app.web.card_lines import QUANTITIES, card_from_text, with_value
from rotorfit.core.errors import CardError
from rotorfit.core.frames import UNIT_SCALE
from rotorfit.files.cards import builtin_card_text, builtin_cards, card_from_mapping

TEXT = """# My drone
name = "one"  # of two

[command]
frame = "heading"
time = "t"
x = { from = "a # b", unit = "deg" }  # + is forward
# y = "TABLE:COLUMN"  # EDIT: nothing was recognised

[pose]
time = "t"   # s
x = "px"
y = "py"
z = "pz"
yaw = "psi"

# All columns: t, a # b, px
"""


def changed(text: str, section: str, key: str, value: Any) -> tuple[list[str], list[str]]:
    """Lines that went and lines that came."""
    before, after = text.splitlines(), with_value(text, section, key, value).splitlines()
    return [line for line in before if line not in after], [line for line in after if line not in before]


def test_a_value_changes_in_its_line_and_the_comment_behind_it_stays() -> None:
    value = {"from": "a # b", "scale": -1, "unit": "deg"}

    assert changed(TEXT, "command", "x", value) == (
        ['x = { from = "a # b", unit = "deg" }  # + is forward'],
        ['x = { from = "a # b", scale = -1, unit = "deg" }  # + is forward'],
    )
    assert changed(TEXT, "pose", "time", "stamp") == (['time = "t"   # s'], ['time = "stamp"   # s'])


def test_the_line_that_waits_for_being_edited_is_filled_in() -> None:
    assert changed(TEXT, "command", "y", "b") == (
        ['# y = "TABLE:COLUMN"  # EDIT: nothing was recognised'],
        ['y = "b"'],
    )


def test_new_keys_and_sections_come_where_they_belong() -> None:
    text = with_value(with_value(TEXT, "limits", "tilt", {"value": 20, "unit": "deg"}), "", "frame", "NED")

    found = tomllib.loads(text)
    assert found["limits"] == {"tilt": {"value": 20, "unit": "deg"}}
    assert found["frame"] == "NED"
    assert found["command"] == tomllib.loads(TEXT)["command"]
    assert set(TEXT.splitlines()) <= set(text.splitlines())


def test_a_key_is_removed() -> None:
    assert changed(TEXT, "pose", "yaw", None) == (['yaw = "psi"'], [])


def test_text_that_lines_cannot_show_is_written_anew_with_the_same_meaning() -> None:
    text = '[command]\ntime = "t"\n[command.x]\nfrom = "a"\n[pose]\ntime = "t"\nx = """p\nx"""\n'

    found = tomllib.loads(with_value(with_value(text, "command", "x", {"from": "a", "scale": -1}), "pose", "x", "px"))

    assert found == {"command": {"time": "t", "x": {"from": "a", "scale": -1}}, "pose": {"time": "t", "x": "px"}}


@pytest.mark.parametrize("name", sorted(builtin_cards()))
def test_every_built_in_card_can_be_edited_and_keeps_all_else(name: str) -> None:
    text = builtin_card_text(name)
    wanted = tomllib.loads(text)
    wanted["command"]["hold"] = 0.25

    found = with_value(text, "command", "hold", 0.25)

    assert tomllib.loads(found) == wanted
    assert [line for line in text.splitlines() if line not in found.splitlines() and "hold" not in line] == []


VALUES = st.recursive(
    st.booleans() | st.integers(-(2**53), 2**53) | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)


@given(st.sampled_from(["", "command", "pose", "new"]), st.text(max_size=8), VALUES)
def test_whatever_is_set_is_what_the_text_says_afterwards(section: str, key: str, value: Any) -> None:
    if not section and key in ("command", "pose"):
        return
    wanted: dict[str, Any] = tomllib.loads(TEXT)
    (wanted.setdefault(section, {}) if section else wanted)[key] = value
    try:
        text = with_value(TEXT, section, key, value)
    except (CardError, UnicodeEncodeError):
        return

    assert {k: v for k, v in tomllib.loads(text).items() if v != {}} == {k: v for k, v in wanted.items() if v != {}}


@pytest.mark.parametrize("text", ["= broken", 'a = "'])
def test_a_text_that_is_not_toml_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(CardError, match=r"^the card is not readable as TOML: [^\n]*$"):
        with_value(text, "pose", "x", "px")


def test_units_that_the_table_offers_are_those_that_a_card_takes() -> None:
    for section, key, _, units in QUANTITIES:
        for unit in units:
            text = with_value(TEXT, section, key, {"from": "a", "unit": unit})
            assert card_from_text(text).raw[section][key]["unit"] == unit
        wrong = next((unit for unit in UNIT_SCALE if units and unit not in units), None)
        if wrong:
            with pytest.raises(CardError, match="is not one of"):
                card_from_mapping(tomllib.loads(with_value(TEXT, section, key, {"from": "a", "unit": wrong})), "x")
