"""What a file is, by its first bytes: one in the place of another is told as such, with the verb that takes it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes:
        text: What it is, in words.
        mark: What such a text file has near its start.
        use: What takes it; `{}` stands for its path.
        instead: By the kind that was wanted, what makes one of it.
    """

    text: str
    mark: str
    use: str
    instead: Mapping[str, str] = field(default_factory=dict)


KINDS: Mapping[str, Kind] = {
    "model": Kind(
        "a model",
        r'\A\s*\{\s*"format"\s*:\s*"rotorfit-model"',
        "`rotorfit validate {} LOG` scores it on a flight",
        {"plan": "`rotorfit plan --after {} -o plan.toml` designs a flight for it"},
    ),
    "plan": Kind(
        "a plan",
        r'^format = "rotorfit-plan"',
        "`rotorfit fly {} --link sim -o flight.mcap` flies it",
    ),
    "gains": Kind(
        "a file of gains",
        r"^format(: | = \")rotorfit-gains",
        "a controller reads it, and `rotorfit track LOG --tune {}` renews it",
    ),
    "vehicle": Kind(
        "a simulated vehicle",
        r"^\[ *(rotors|loops) *\]",
        "`rotorfit fly plan.toml --link sim:{} -o flight.mcap` flies it",
        {"card": "its card is sim:{}"},
    ),
    "card": Kind(
        "a card",
        r"^\[ *(command|pose) *\]",
        "`rotorfit fit LOG --card {}` reads a log by it",
        {"plan": "`rotorfit plan --card {} -o plan.toml` designs a flight with it"},
    ),
    "export": Kind("an export of a model", r"written by rotorfit export", "it is for other programs: docs/exports.md"),
    "page": Kind("a page", r"\A\s*<!doctype html", "open it in a browser"),
    "log": Kind(
        "a log",
        r"(?!)",  # told by the readers of logs
        "`rotorfit fit {} -o model.json` makes a model of it",
        {"card": "`rotorfit info {} --draft-card my-drone.toml` drafts one for it"},
    ),
}
"""Every kind by its name, in the order of asking."""


def told_instead(path: str | Path, found: str, wanted: str) -> str:
    """One line about a file of another kind than the wanted one, with what takes it; kinds are names in `KINDS`."""
    use = KINDS[found].instead.get(wanted, KINDS[found].use).format(quote(str(path)))
    return f"{path} is {KINDS[found].text}, not {KINDS[wanted].text}: {use}"


def text_kind(head: bytes) -> str:
    """The name in `KINDS` of a text file of ours, by its first bytes; empty for any other, and for logs."""
    text = "" if b"\0" in head else head.decode("utf-8", "replace")
    flags = re.MULTILINE | re.IGNORECASE
    return next((name for name, kind in KINDS.items() if re.search(kind.mark, text, flags)), "")
