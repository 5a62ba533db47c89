"""The river: a module of rotorfit imports only what stands above it in this list."""

import ast
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

import rotorfit

RIVER = (
    "errors",
    "finding",
    "frames",
    "log",
    "card",
    "card_file",
    "card_columns",
    "joined",
    "log_span",
    "settings",
    "published",
    "sources",
    "clock",
    "columns",
    "derivative",
    "beside",
    "window",
    "stream",
    "ground",
    "straight",
    "stamping",
    "lag_search",
    "clock_offset",
    "witnesses",
    "one_clock",
    "velocity",
    "flight",
    "recognition",
    "proposal",
    "held",
    "regression",
    "two_files",
    "clock_checks",
    "command_checks",
    "pose_checks",
    "motion_checks",
    "frame_checks",
    "restoring",
    "answers",
    "sign_checks",
    "draft_text",
    "draft",
    "doctor",
    "survey",
    "structure",
    "response",
    "motion_step",
    "motion",
    "disturbance",
    "fusion",
    "measured",
    "prediction",
    "forecast",
    "long_run",
    "events",
    "paired",
    "levels",
    "record",
    "point",
    "likelihood",
    "prior",
    "maximum",
    "modes",
    "estimate",
    "latency",
    "accuracy",
    "model",
    "model_file",
    "whiteness",
    "physics",
    "convert",
    "settle",
    "sandwich",
    "stretch",
    "equation",
    "freerun",
    "rung",
    "problem",
    "delay",
    "filtered",
    "instrument",
    "output_error",
    "rungs",
    "profile",
    "robust",
    "scatter",
    "further",
    "enrich",
    "select",
    "statement",
    "clock_error",
    "fit",
    "bootstrap",
    "uncertainty",
    "influence",
    "validation",
    "ladder",
    "leave_one_out",
    "constancy",
    "too_early",
    "advice",
    "plausibility",
    "summary",
    "pipeline",
    "case",
    "exports",
    "views",
    "evidence",
    "excitation",
    "paper_vehicle",
    "paper_log",
    "vehicle",
    "air",
    "rigid_body",
    "sensors",
    "simulator",
    "plan",
    "plan_file",
    "space",
    "tracking",
    "belief",
    "rehearsal",
    "precision",
    "envelope",
    "held_motion",
    "axis_information",
    "optimal",
    "planning",
    "next_flight",
    "request",
    "expected",
    "preview",
    "control_law",
    "bandwidth",
    "margins",
    "robustness",
    "tune",
    "gains_file",
    "reference_paths",
    "steering",
    "links",
    "trial",
    "recorder",
    "guard",
    "braking",
    "realtime",
    "abort",
    "preflight",
    "flown",
    "fly",
    "mission",
    "report",
    "demo",
    "terminal",
    "studio",
    "__init__",
    "cli",
    "__main__",
)
"""In the order in which the data flow. A folder is one module; inside it only mutual imports are forbidden."""

ESTIMATOR = set(RIVER[RIVER.index("derivative") : RIVER.index("advice")])
ROOT = Path(rotorfit.__file__).parent
NAMED = re.compile(r"(rotorfit(?:\.\w+)+)(?::\w+)?")
"""A module named in a string, alone or as `module:object`: what is imported only when asked for."""


def module_paths(root: Path) -> dict[str, Path]:
    """Dotted name, below the package, of every module: `log`, `sources.csv`, `sources.__init__`."""
    return {".".join(path.relative_to(root).with_suffix("").parts): path for path in sorted(root.rglob("*.py"))}


def imported_names(path: Path, package: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Every dotted name that a file imports, at any depth of it; relative imports resolved within `package`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (tuple(alias.name.split(".")) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            parts = (*base, *(node.module.split(".") if node.module else ()))
            yield from ((*parts, alias.name) for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and (named := NAMED.fullmatch(node.value)):
            parts = tuple(named[1].split("."))
            yield from [] if parts == package else [parts]  # a package may name itself, to find its own data


def imports_of(name: str, paths: dict[str, Path]) -> set[str]:
    """The project's own modules that one module imports."""
    own = set()
    for first, *rest in imported_names(paths[name], ("rotorfit", *name.split(".")[:-1])):
        if first != "rotorfit" or rest == ["__version__"]:  # the version stands before everything else in __init__
            continue
        while rest and ".".join(rest) not in paths and ".".join([*rest, "__init__"]) not in paths:
            rest.pop()
        plain = ".".join(rest)
        own.add(plain if plain in paths else ".".join([*rest, "__init__"]))
    return own - {name}


def graph_of(root: Path) -> dict[str, set[str]]:
    paths = module_paths(root)
    return {name: imports_of(name, paths) for name in paths}


def top(name: str) -> str:
    return name.split(".")[0]


def against_the_stream(graph: dict[str, set[str]]) -> list[str]:
    place = {name: position for position, name in enumerate(RIVER)}
    listed = {
        name: {other for other in others if top(other) in place} for name, others in graph.items() if top(name) in place
    }
    return [
        f"{name} imports {other}, which does not stand above it"
        for name, others in listed.items()
        for other in sorted(others)
        if top(other) != top(name) and place[top(other)] > place[top(name)]
    ]


def mutual_pairs(graph: dict[str, set[str]]) -> list[tuple[str, str]]:
    return [(a, b) for a, others in graph.items() for b in sorted(others) if a < b and a in graph[b]]


def reached_from(name: str, graph: dict[str, set[str]]) -> set[str]:
    reached, ahead = set(), {name}
    while ahead:
        reached |= ahead
        ahead = {other for one in ahead for other in graph[one]} - reached
    return reached


# The project


def test_every_module_has_its_place_in_the_list() -> None:
    assert {top(name) for name in module_paths(ROOT)} <= set(RIVER)


def test_modules_import_only_what_stands_above_them() -> None:
    assert against_the_stream(graph_of(ROOT)) == []


def test_no_two_modules_import_each_other() -> None:
    assert mutual_pairs(graph_of(ROOT)) == []


def test_no_stem_is_used_twice() -> None:
    stems = [name.split(".")[-1] for name in module_paths(ROOT)]

    assert sorted({stem for stem in stems if stems.count(stem) > 1} - {"__init__"}) == []


def test_the_simulator_shares_nothing_with_the_estimator_not_even_through_others() -> None:
    graph = graph_of(ROOT)

    reached = {top(name) for start in ("paper_log", "simulator") for name in reached_from(start, graph)}
    assert {"frames", "rigid_body"} <= reached
    assert not reached & ESTIMATOR


# The test itself


def river_in(root: Path, files: dict[str, str]) -> dict[str, set[str]]:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return graph_of(root)


@pytest.mark.parametrize(
    "line",
    [
        "from rotorfit.fit import best",
        "from rotorfit import fit",
        "import rotorfit.fit",
        "import rotorfit.fit as other",
        "from .fit import best",
        "from . import fit",
        "def later():\n    from rotorfit.fit import best",
        "TABLE = {'name': 'rotorfit.fit:best'}",
    ],
)
def test_an_import_from_below_is_seen_however_it_is_written(tmp_path: Path, line: str) -> None:
    graph = river_in(tmp_path, {"__init__.py": "", "fit.py": "best = 1", "log.py": line})

    assert against_the_stream(graph) == ["log imports fit, which does not stand above it"]


def test_imports_from_above_from_outside_and_between_siblings_are_let_through(tmp_path: Path) -> None:
    graph = river_in(
        tmp_path,
        {
            "__init__.py": "from rotorfit.fit import best",
            "log.py": "import numpy.fit\nfrom pathlib import Path",
            "fit.py": "'''Not rotorfit.cli in a sentence.'''\n"
            "from rotorfit import __version__\nfrom rotorfit.log import Log\nfrom rotorfit.sources import csv",
            "sources/__init__.py": "from rotorfit.sources.csv import read",
            "sources/csv.py": "from .content import Content\nfrom ..log import Log",
            "sources/content.py": "",
        },
    )

    assert graph["fit"] == {"log", "sources.csv"}
    assert graph["sources.csv"] == {"log", "sources.content"}
    assert against_the_stream(graph) == []
    assert mutual_pairs(graph) == []


def test_mutual_imports_are_seen_inside_a_folder_too(tmp_path: Path) -> None:
    graph = river_in(
        tmp_path,
        {
            "__init__.py": "",
            "sources/__init__.py": "from rotorfit.sources import csv",
            "sources/csv.py": "from . import read",
        },
    )

    assert mutual_pairs(graph) == [("sources.__init__", "sources.csv")]


def test_what_is_reached_through_others_counts(tmp_path: Path) -> None:
    chain = {f"{a}.py": f"from rotorfit.{b} import x" for a, b in pairwise(["simulator", "views", "fit", "log"])}
    graph = river_in(tmp_path, {"__init__.py": "", "log.py": "", **chain})

    assert reached_from("simulator", graph) == {"simulator", "views", "fit", "log"}
