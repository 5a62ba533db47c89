"""The house: packages in the order in which the data flow, nouns that cost nothing to name, no private visits.

The order itself is the contracts of `pyproject.toml` ([tool.importlinter]); they are run here too, so that one command
proves all of it.
"""

import ast
from pathlib import Path

import grimp
import pytest
from importlinter.cli import lint_imports

import rotorfit

ROOT = Path(rotorfit.__file__).parent
PACKAGES = (
    "app", "assessment", "control", "core", "diagnosis", "dynamics", "estimation", "exports", "files", "flights",
    "flying", "planning", "reporting", "simulation", "tracking",
)  # fmt: skip
NOUNS = {
    "core.log": ("Log",),
    "core.card": ("Card",),
    "core.flight_data": ("Flight",),
    "core.model": ("Model", "Axis"),
    "core.results": ("Fit", "Validation"),
    "core.flight_plan": ("Plan",),
    "core.tracked": ("Tracked", "Alarm", "Track"),
    "core.finding": ("Finding",),
    "core.errors": ("RotorfitError",),
    "core.frames": ("AXES",),
}
"""Module to the nouns that it defines."""

NOUN_REACH = 3
KERNEL_REACH = 10
"""One of them is `core.compiled`."""

COMPOSED = (
    "dynamics.error_bands",
    "dynamics.other_limits",
    "dynamics.predictor",
    "dynamics.protocol",
    "dynamics.trajectory",
    "simulation.flight_room",
)
"""What composes kernels: predictions, their states and bands, a model under a card of other limits, simulation by a
model, the virtual flight room."""


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    return grimp.build_graph("rotorfit", cache_dir=None, exclude_type_checking_imports=True)  # they cost nothing


def reach(graph: grimp.ImportGraph, module: str) -> set[str]:
    """The project's own modules that a module needs, through others too; packages themselves left out."""
    return {
        name
        for name in graph.find_upstream_modules(f"rotorfit.{module}")
        if not (ROOT.parent / Path(*name.split("."))).is_dir() and name != "rotorfit.version"
    }


def test_contracts_hold(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parents[1])

    assert lint_imports(no_cache=True) == 0, capsys.readouterr().out


def test_fifteen_packages_and_nothing_beside_them() -> None:
    assert tuple(sorted(path.name for path in ROOT.iterdir() if (path / "__init__.py").is_file())) == PACKAGES
    assert sorted(path.name for path in ROOT.glob("*.py")) == ["__init__.py", "__main__.py", "version.py"]


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_says_its_job_what_comes_in_and_what_goes_out(package: str) -> None:
    text = ast.get_docstring(ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8")))

    assert text is not None
    assert len(text.split()) >= 20
    assert " come" in text or " goes" in text or " go " in text


@pytest.mark.parametrize("module", NOUNS)
def test_naming_a_noun_costs_next_to_nothing(graph: grimp.ImportGraph, module: str) -> None:
    defined = (ROOT / Path(*module.split("."))).with_suffix(".py").read_text(encoding="utf-8")

    assert all(
        f"class {noun}" in defined or f"{noun} = " in defined or f"{noun}: " in defined for noun in NOUNS[module]
    )
    assert len(reach(graph, module)) <= NOUN_REACH


def kernels(graph: grimp.ImportGraph) -> list[str]:
    inside = [
        m[9:] for m in graph.modules if m.startswith(("rotorfit.core.", "rotorfit.dynamics.", "rotorfit.simulation."))
    ]
    return [module for module in inside if module not in COMPOSED]


def test_kernels_reach_few(graph: grimp.ImportGraph) -> None:
    assert {m: len(reach(graph, m)) for m in kernels(graph) if len(reach(graph, m)) > KERNEL_REACH} == {}


def test_public_functions_have_no_namesake_among_modules(graph: grimp.ImportGraph) -> None:
    public = {name for name in rotorfit.__all__ if name.islower()}

    assert {m for m in graph.modules if m.split(".")[-1] in public} - {f"rotorfit.{p}" for p in PACKAGES} == set()
    assert public & set(PACKAGES) == set()


def test_nothing_private_is_imported_from_another_module() -> None:
    visits = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.module}.{alias.name}"
        for path in sorted(ROOT.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("rotorfit")
        for alias in node.names
        if any(part.startswith("_") and not part.endswith("__") for part in (*node.module.split("."), alias.name))
    ]

    assert visits == []


def test_tests_mirror_the_packages() -> None:
    here = Path(__file__).parent
    folders = {path.parent.name for path in here.rglob("test_*.py") if path.parent != here}

    assert folders <= set(PACKAGES)
    assert set(PACKAGES) - folders == set()
