"""Texts from strangers: plain types, or one line; never a trace, and never for long."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorfit.core.plain import DEEPEST, LONGEST_NAME, line_of, plain_json, plain_toml, toml_text, visible

WRONG_TOML = {
    "no TOML": "name = ",
    "3,000 dots": "a." * 3000 + "a = 1",
    "a million dots": "a." * 1_000_000 + "a = 1",
    "100 dots": "a." * 100 + "a = 1",
    "100,000 brackets": "a = " + "[" * 100_000,
    "300 inline sections": "a = {a = " * 300 + "1",
    "a section of 50 parts": "[a" + ".a" * 50 + "]",
    "5,000 digits": "a = " + "9" * 5000,
    "400 digits": "a = " + "9" * 400,
    "a name of a page": "a" * 5000 + " = 1",
    "a control character": "a = 1 # \x07",
    "8 MiB": "# " + "a" * (8 << 20),
}

WRONG_JSON = {
    "no JSON": "{",
    "100,000 brackets": "[" * 100_000,
    "40 brackets": "[" * 40 + "]" * 40,
    "5,000 digits": "9" * 5000,
    "400 digits": "[" + "9" * 400 + "]",
    "more than a float": '{"a": 1e400}',
    "NaN": '{"a": NaN}',
    "an infinity": '{"a": -Infinity}',
    "no UTF-8": b'"\xff\xfe"',
    "a name of a page": '{"' + "a" * 5000 + '": 1}',
}


def check_one_line(error: pytest.ExceptionInfo[ValueError]) -> None:
    text = str(error.value)
    assert text
    assert text.isprintable()
    assert len(text) <= LONGEST_NAME


@pytest.mark.parametrize("case", WRONG_TOML)
def test_what_no_card_has_is_one_line(case: str) -> None:
    with pytest.raises(ValueError) as error:  # noqa: PT011 - its text is checked
        plain_toml(WRONG_TOML[case])
    check_one_line(error)


@pytest.mark.parametrize("case", WRONG_JSON)
def test_what_no_model_has_is_one_line(case: str) -> None:
    with pytest.raises(ValueError) as error:  # noqa: PT011 - its text is checked
        plain_json(WRONG_JSON[case])
    check_one_line(error)


def test_what_is_sound_is_what_the_parsers_give() -> None:
    text = "a.b.c = [1, 2.5, true]\n[d]\ne = '...' # a. b. c.\n"

    assert plain_toml(text) == tomllib.loads(text)
    assert plain_json('{"a": [1, {"b": "\\ud83d\\ude00"}]}') == {"a": [1, {"b": "😀"}]}
    assert plain_json(b"[" * DEEPEST + b"]" * DEEPEST)


@given(st.text())
def test_any_text_is_a_value_and_a_comment_of_toml(text: str) -> None:
    assert tomllib.loads(f"a = {toml_text(text)}  # {visible(text)}") == {"a": text}


@given(st.text(st.characters()))
def test_any_text_is_one_visible_line(text: str) -> None:
    line = line_of(text, 50)

    assert len(line) <= 50
    assert line == visible(line)
    assert len(line.splitlines()) <= 1
    line.encode()


def test_half_a_surrogate_pair_as_of_a_file_name_is_written_as_a_character() -> None:
    assert toml_text("a\udcffb") == '"a\ufffdb"'
    assert visible("a\udcffb\n") == "a\\udcffb\\n"
