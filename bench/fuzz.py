"""Mutated files and command lines of every kind: does rotorfit ever crash, hang, exhaust memory or show a traceback?

    python bench/fuzz.py [--minutes 10] [--seed 0] [--keep FOLDER] [--corpus FOLDER] [KIND...]

A kind is a row of `KINDS`: samples, a mutator and a reader. Logs are mutated byte by byte, text as its parsed tree:
types, nesting, huge numbers, NaN, control characters, keys that are duplicated, unknown or missing. Where atheris is
installed (`pip install atheris`), text that reaches new lines of code is kept for further mutation; without it, and for
logs, whose readers are compiled, inputs with a new outcome are kept. A kind has a process of its own for the given
minutes. Failures are saved in the folder `--keep`: a process ended by a signal, an exception that is not rotorfit's
own, an error of several lines, more than 10 s of processor time, more than 1 GB. The exit code is then 1.
"""

import argparse
import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomli_w

TESTS = Path(__file__).resolve().parents[1] / "tests/files"
SOURCE = Path(__file__).resolve().parents[1] / "src/rotorfit"
EARLIER = TESTS / "version_0_1"
SECONDS, MEGABYTES, LONGEST = 10, 1000, 200_000
TREES = 20  # that follow from one text
REQUESTS = 20  # of a session of the studio
MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
EXTREMES = (b"\0", b"\xff", b"\x7f", b"\x80", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0\0\0\0\0")
STRANGE: tuple[Any, ...] = (
    0, -1, 1, 2**63, -(2**63), 1e308, -1e308, 5e-324, float("nan"), float("inf"), -float("inf"), True, False,
    "", "\n", "\x00", "\x1b[2J", "\u202e", "é" * 2000, "-", "---", "../..", "!!python/object/apply:os.system",
    "{{ 7 * 7 }}", "nan", "1:2", "x", [], {}, [[]], [{}], [1, 2], {"x": 1}, {"from": "a:b", "scale": 0},
)  # fmt: skip
KEYS = ("", "x", "yaw", "time", "from", "unit", "scale", "a.b", "é", "\n", "\x1b", "name", "format", "k" * 1500)


@dataclass(frozen=True)
class Kind:
    """What is fed with strange input.

    Attributes:
        samples: Where changing begins.
        mutated: A sample, changed.
        read: What is to bear the file that holds it; says how it went, in a word.
        parse: Text to a tree, where there is one.
        check: What is to bear the tree.
    """

    samples: list[bytes]
    mutated: Callable[[bytes, random.Random], bytes]
    read: Callable[[Path], str]
    parse: Callable[[bytes], Any] | None = None
    check: Callable[[Any], object] | None = None


def bytes_changed(content: bytes, rng: random.Random) -> bytes:
    """A few changes: wrong bytes, extreme numbers, blocks that are gone, doubled, moved or noise, a cut end."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 3, 6, 20))):
        # Heads and definitions, which stand at the front or at the end, are hit more often than payload.
        place = int(len(data) * rng.choice((rng.random() ** 3, 1 - rng.random() ** 3, rng.random())))
        length = rng.choice((1, 2, 4, 8, 40, 400, 4000))
        match rng.randrange(8):
            case 0 | 1:
                data[place : place + 1] = bytes([rng.randrange(256)])
            case 2:
                extreme = rng.choice(EXTREMES)
                data[place : place + len(extreme)] = extreme
            case 3:
                del data[place : place + length]
            case 4:
                data[place:place] = data[place : place + length]
            case 5:
                other = rng.randrange(len(data) or 1)
                data[place : place + length] = data[other : other + length]
            case 6:
                data[place : place + length] = rng.randbytes(length)
            case _:
                data = data[: max(1, place)] if rng.random() < 0.3 else data
    return bytes(data)


def places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Holder and key of every value in a tree."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from places(tree[key])


def tree_changed(tree: Any, rng: random.Random) -> None:
    """A few changes of a parsed tree: other values and types, keys that are unknown, gone or moved, deeper nesting."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        if not (known := list(places(tree))):
            return
        holder, key = rng.choice(known)
        value = holder[key]
        match rng.randrange(7):
            case 0 | 1:
                holder[key] = deepcopy(rng.choice(STRANGE))
            case 2:
                other, place = rng.choice(known)
                holder[key] = json.loads(json.dumps(other[place], default=str))
            case 3:
                number = isinstance(value, float) or (type(value) is int and abs(value) < 1e18)
                holder[key] = value * rng.choice((-1, 0, 1e-300, 1e9, 1e300, 1 + 1e-9)) if number else str(value)
            case 4:
                del holder[key]
            case 5 if isinstance(holder, dict):
                holder[rng.choice(KEYS)] = value
            case 5:
                holder.extend(holder[: rng.choice((1, 100))])
            case _:
                for _ in range(rng.choice((1, 2, 40))):
                    holder[key] = [holder[key]] if rng.random() < 0.5 else {"a": holder[key]}


def text_changed(content: bytes, rng: random.Random) -> bytes:
    """Lines that are double, gone or exchanged; among them are double keys and sections."""
    lines = content.split(b"\n")
    for _ in range(rng.choice((1, 1, 3))):
        one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        match rng.randrange(3):
            case 0:
                lines.insert(one, lines[other])
            case 1:
                lines[one], lines[other] = lines[other], lines[one]
            case _:
                lines[one] = bytes_changed(lines[one], rng)
    return b"\n".join(lines)


def parsed_and_changed(
    parse: Callable[[bytes], Any], text: Callable[[Any], bytes], content: bytes, rng: random.Random
) -> bytes:
    """A text changed as the tree that it is parsed to, now and then as lines or bytes; so is what is no tree."""
    changed, way = content, rng.random()
    if way < 0.8:
        try:
            tree = parse(content)
            tree_changed(tree, rng)
            changed = text(tree)
        except (ValueError, TypeError, RecursionError, AttributeError):
            way = 1.0
    if way >= 0.8:
        changed = (text_changed if way < 0.9 else bytes_changed)(content, rng)
    return changed if len(changed) < LONGEST else content


def toml(data: bytes) -> Any:
    return tomllib.loads(data.decode())


toml_changed = partial(parsed_and_changed, toml, lambda tree: tomli_w.dumps(tree).encode())
json_changed = partial(parsed_and_changed, json.loads, lambda tree: json.dumps(tree).encode())


def json_line_changed(content: bytes, rng: random.Random) -> bytes:
    """Lines of JSON, one of them changed as a tree."""
    lines = content.split(b"\n")
    place = rng.randrange(len(lines))
    lines[place] = json_changed(lines[place], rng)
    return b"\n".join(lines)


GUIDING = ("tomllib", "json", "rotorfit.core", "rotorfit.files", "rotorfit.simulation.vehicle")


def log(name: str, folder: Path) -> Kind:
    """Logs of a format as the tests write them, those of folders by their storage."""
    sys.path[:0] = [str(TESTS), str(TESTS.parent)]
    from test_sources import WRITERS, recording

    from rotorfit.files.logs import read

    found = []
    for case, (kind, write) in WRITERS.items():
        if kind == name:
            path = write(folder / f"{len(found)}_{case.replace(' ', '_')}", recording())
            files = [path] if path.is_file() else [file for file in path.iterdir() if file.name != "metadata.yaml"]
            found += [file.read_bytes() for file in files]

    def go(path: Path) -> str:
        content = read(path)
        return "read with a note" if content.notes or content.damage else "read"

    return Kind(found, json_line_changed if name == "jsonl" else bytes_changed, go)


def cards(_: Path) -> Kind:
    """Cards: the built-in ones."""
    from rotorfit.files.cards import card_from_mapping, load_card

    def go(path: Path) -> str:
        load_card(path)
        return "read"

    samples = [path.read_bytes() for path in (SOURCE / "files/builtin_cards").iterdir()]
    return Kind(
        [*samples, (EARLIER / "card-complete.toml").read_bytes()],
        toml_changed,
        go,
        toml,
        partial(card_from_mapping, where="here"),
    )


def vehicles(_: Path) -> Kind:
    """Vehicles of the flight room."""
    from rotorfit.simulation.vehicle import load_vehicle, vehicle_from_mapping

    def go(path: Path) -> str:
        load_vehicle(str(path))
        return "read"

    samples = [path.read_bytes() for path in (SOURCE / "simulation/vehicles").iterdir()]
    return Kind(samples, toml_changed, go, toml, partial(vehicle_from_mapping, where="here"))


def plans(_: Path) -> Kind:
    """Plans: what is read must be written and read again."""
    from rotorfit.files.plans import load_plan, plan_from_mapping, plan_from_text, plan_text
    from rotorfit.planning.belief import belief_from_mapping

    def go(path: Path) -> str:
        plan = load_plan(path)
        assert plan_from_text(plan_text(plan), "again") == plan
        if plan.belief:
            belief_from_mapping(plan.belief, "here")
        return "read"

    samples = [path.read_bytes() for path in EARLIER.glob("plan*.toml")]
    return Kind(samples, toml_changed, go, toml, partial(plan_from_mapping, where="here"))


def models(_: Path) -> Kind:
    """Model files: what is read must be written and read again."""
    from rotorfit.files.models import from_mapping, load, to_mapping

    def go(path: Path) -> str:
        model = load(path)
        again = json.loads(json.dumps(to_mapping(model), allow_nan=False))
        assert to_mapping(from_mapping(again, "again")) == to_mapping(model)
        return "read"

    samples = [(EARLIER / f"model{name}.json").read_bytes() for name in MODELS]
    return Kind(samples, json_changed, go, json.loads, partial(from_mapping, where="here"))


MODELS = ("-iv", "-paper", "-oe", "-converted", "-auto")


def gains(folder: Path) -> Kind:
    """Gains of a model of any content: both languages must parse to the same."""
    from ruamel.yaml import YAML

    import rotorfit
    from rotorfit.exports.gains import save_gains

    tuning = rotorfit.tune(EARLIER / "model-iv.json", axes=("x",))
    yaml = YAML(typ="safe", pure=True)

    def go(path: Path) -> str:
        model = rotorfit.load(path)
        save_gains(tuning, model, folder / "gains.toml")
        save_gains(tuning, model, folder / "gains.yaml")
        text = (folder / "gains.toml").read_text(encoding="utf-8")
        assert tomllib.loads(text) == yaml.load((folder / "gains.yaml").read_text(encoding="utf-8"))
        return "written"

    return Kind([(EARLIER / "model-iv.json").read_bytes()], json_changed, go)


LINES = (
    "info flight.csv --card card.toml", "info flight.csv@1:3 --json", "info flight.csv --draft-card new.toml --fresh",
    "fit flight.csv@0:5 flight.csv --card card.toml -o out.json --axes x,y --method paper --structure auto",
    "validate model.json flight.csv --horizons 0.5,1,2 --json", "compare model.json model.json flight.csv@10:",
    "report model.json --on flight.csv -o out.html", "convert model.json --limits tilt=10deg -o out.json",
    "tune model.json --axes z --rate 50 -o out.toml", "export model.json --to c -o out.h --dt 0.02",
    "export model.json --to python -o out.py --predictor", "export", "cards", "cards bebop2 --json", "formats --json",
    "plan --card bebop2 --room 6x4x3 --axes x,y --duration 20 -o out.toml --box 0,0,0,1,1,1 --seed 3",
    "plan --after model.json --design chirp --speed 1 --amplitude 0.5", "ladder flight.csv --card card.toml --json",
    "fly plan.toml --link sim:bebop2,gusts=0.2 -o out.mcap --yes --take-off", "demo folder", "studio folder --port 0",
)  # fmt: skip
QUICK = ("info", "convert", "export", "cards", "formats")
WORDS = (
    "", "-", "--", "@", "+", ":", ",", "=", "x,,y", "nan", "inf", "-inf", "1e999", "-1", "0", "9" * 400, "5000000000",
    "\x01", "\x1b[2J", "\udcff", "é", "a" * 5000, "flight.csv+flight.csv", "flight.csv@", "flight.csv@nan:2", "@1:2",
    "flight.csv@5:1", "1e9x1e9x1e9", "0x0x0", "tilt=nandeg", "tilt=1e308deg", "tilt=10", "[0]", "--json", "--help",
)  # fmt: skip


def command_lines(folder: Path) -> Kind:
    """Command lines: all of them are parsed, those that take no long are run in a folder of small files."""
    from click.testing import CliRunner

    from rotorfit.app.cli import main

    for name in ("card.toml", "plan.toml", "flight.csv"):
        (folder / name).write_bytes(b"\n".join((EARLIER / name).read_bytes().split(b"\n")[:420]))
    (folder / "model.json").write_bytes((EARLIER / "model-iv.json").read_bytes())
    os.chdir(folder)
    options = [name for verb in main.commands.values() for one in verb.params for name in one.opts]

    def changed(content: bytes, rng: random.Random) -> bytes:
        words = content.decode("utf-8", "surrogateescape").split("\n")
        for _ in range(rng.choice((1, 1, 2, 4))):
            place = rng.randrange(len(words) + 1)
            word = rng.choice((*WORDS, *rng.sample(options, 9), rng.choice(words) if words else ""))
            match rng.randrange(4):
                case 0:
                    words[place : place + 1] = [word]
                case 1:
                    words.insert(place, word)
                case 2:
                    del words[place : place + 1]
                case _:
                    part = words[place % len(words)] if words else ""
                    cut = rng.randrange(len(part) + 1)
                    words[place : place + 1] = [part[:cut] + rng.choice((word, "")) + part[cut + rng.randrange(2) :]]
        line = "\n".join(words).replace("/", "_").replace("\0", "")  # which no system lets through
        return line.encode("utf-8", "surrogateescape")[:20_000]

    def go(path: Path) -> str:
        words = path.read_bytes().decode("utf-8", "surrogateescape").split("\n")
        if words[0] not in QUICK:
            return parsed_only(main, words)
        done = CliRunner().invoke(main, words)
        if done.exception and not isinstance(done.exception, SystemExit):
            raise done.exception
        if done.exit_code == 1 and len(done.stderr.strip().splitlines()) > 1:
            raise AssertionError(f"several lines: {done.stderr[-200:]!r}")
        return f"ended with {done.exit_code}"

    return Kind(["\n".join(line.split()).encode() for line in LINES], changed, go)


def studio(folder: Path) -> Kind:
    """Sessions of the studio, each a number from which its requests follow."""
    from types import SimpleNamespace

    sys.path[:0] = [str(TESTS), str(TESTS.parent)]
    from rotorfit.app.web import runner
    from studio_requests import Hostile
    from studio_room import opened

    runner.sys = SimpleNamespace(executable="true")  # type: ignore[attr-defined]  # fits that end at once

    def go(path: Path) -> str:
        with TemporaryDirectory(dir=folder) as place, opened(Path(place) / "workspace") as one:
            page = Hostile(one, int(path.read_bytes()))
            return " ".join(str(page.once()[2]) for _ in range(REQUESTS))

    return Kind([b"0"], lambda _, rng: b"%d" % rng.randrange(10**12), go)


def parsed_only(main: Any, words: list[str]) -> str:
    """How the words of a command line are understood, without running it."""
    import click
    from click.testing import CliRunner

    try:
        with CliRunner().isolation():
            name, verb, rest = main.resolve_command(main.make_context("rotorfit", list(words)), list(words))
            verb.make_context(name, rest)
    except (click.ClickException, click.exceptions.Exit) as end:
        return f"parsed: {type(end).__name__}"
    return "parsed"


def kinds() -> dict[str, Callable[[Path], Kind]]:
    """Every kind by its name; what makes it takes a folder to work in."""
    from rotorfit.files.logs import FORMATS

    texts = {"card": cards, "vehicle": vehicles, "plan": plans, "model": models, "gains": gains, "line": command_lines}
    texts["studio"] = studio
    return texts | {name: partial(log, name) for name in FORMATS}


def peak() -> float:
    """Largest memory of this process or one that it started, so far [MB]."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(one).ru_maxrss for one in who) / 1e3


@dataclass
class Farm:
    """One kind at work.

    Attributes:
        name: Of the kind.
        kind: What is fed.
        path: Where its input is written to.
        keep: Where finds are put.
        seconds: How long.
        wrong: Finds by what they are.
        ends: How inputs ended, in words without their values, and how often.
    """

    name: str
    kind: Kind
    path: Path
    keep: Path
    seconds: float
    wrong: Counter[str] = field(default_factory=Counter)
    ends: Counter[str] = field(default_factory=Counter)
    start: float = field(default_factory=time.monotonic)

    def feed(self, content: bytes) -> bool:
        """Reads one input, and trees that follow from it; whether it ended as none did before."""
        self.path.write_bytes(content)
        fresh = self.judged(lambda: self.kind.read(self.path), lambda: content)
        if self.kind.parse:
            rng = random.Random(content)
            try:
                tree = self.kind.parse(content)
            except (ValueError, RecursionError):
                return fresh
            if not isinstance(tree, dict):
                return fresh
            for _ in range(TREES):
                tree_changed(tree, rng)
                self.judged(lambda: self.checked(tree), lambda: json.dumps(tree, default=str).encode())
        return fresh

    def checked(self, tree: Any) -> str:
        """Has a tree checked that a parser could have given."""
        from rotorfit.core.plain import _check

        try:
            _check(tree)
        except ValueError:
            return "refused: by the parser"
        assert self.kind.check
        self.kind.check(tree)
        return "taken"

    def judged(self, read: Callable[[], str], content: Callable[[], bytes]) -> bool:
        """Sees how one input ends; whether none ended so before."""
        from rotorfit.core.errors import RotorfitError
        from rotorfit.core.plain import visible

        if time.monotonic() > self.start + self.seconds:
            self.finish()
        fault, limit = "", max(MEGABYTES, peak())
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            end = read()
        except RotorfitError as error:
            end = "refused: " + re.sub(r"'.*?'|\"(.*?)\"|\S*\d\S*|\S+/\S+", "_", str(error))[:200]
            fault = "" if str(error) == visible(str(error)) else f"an error of several lines: {error!r}"
        except Exception as error:  # noqa: BLE001 - whatever it is, it is what is looked for
            end = fault = f"{type(error).__name__}: {error}"[:300]
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        if not fault and peak() > limit:
            fault = f"{peak():.0f} MB"
        if fault:
            self.found(re.sub(r"'.*'|\".*\"|\d+", "_", fault.splitlines()[0]), fault, content())
        self.ends[end] += 1
        return self.ends[end] == 1

    def found(self, what: str, fault: str, content: bytes) -> None:
        """Keeps the first inputs of each fault."""
        self.wrong[what] += 1
        if self.wrong[what] <= 3:
            self.keep.mkdir(parents=True, exist_ok=True)
            (self.keep / f"{self.name}-{sha256(content).hexdigest()[:12]}").write_bytes(content)
            print(f"  {self.name}: {fault.splitlines()[0]}", file=sys.__stdout__, flush=True)

    def finish(self) -> None:
        """Leaves the figures behind and ends the process, which a library may be running in."""
        refused = sum(count for end, count in self.ends.items() if end.startswith("refused"))
        row = {
            "inputs": self.ends.total(), "refused": refused, "ways": len(self.ends), "finds": len(self.wrong),
            "seconds": time.monotonic() - self.start, "peak": peak(),
        }  # fmt: skip
        self.path.with_name("figures.json").write_text(json.dumps(row))
        os._exit(0)


def overdue(*_: object) -> None:
    raise TimeoutError(f"more than {SECONDS} s of processor time")


def work(name: str, seconds: float, seed: int, folder: Path, keep: Path, corpus: Path) -> None:
    """Feeds one kind until its time is over."""
    sys.setrecursionlimit(1000)
    os.environ["HOME"] = str(folder)
    (folder / "input").mkdir()
    keep, corpus = keep.resolve(), corpus.resolve()
    corpus.mkdir(parents=True, exist_ok=True)
    try:
        import atheris
    except ImportError:
        atheris = None
    if atheris and name in ("card", "vehicle", "plan", "model"):
        with atheris.instrument_imports(include=list(GUIDING)):
            kind = kinds()[name](folder)
    else:
        kind, atheris = kinds()[name](folder), None
    for content in kind.samples:
        (corpus / sha256(content).hexdigest()[:16]).write_bytes(content)
    farm = Farm(name, kind, folder / "log", keep, seconds)
    signal.signal(signal.SIGPROF, overdue)
    if atheris:
        words = [name, f"-seed={seed + 1}", f"-max_len={LONGEST}", "-timeout=60", "-rss_limit_mb=0", "-verbosity=0"]
        atheris.Setup(
            [*words, str(corpus)], lambda data: farm.feed(data) and None,
            custom_mutator=lambda data, most, own: kind.mutated(data or kind.samples[0], random.Random(own))[:most],
        )  # fmt: skip
        atheris.Fuzz()
    rng = random.Random(seed)
    contents = [path.read_bytes() for path in sorted(corpus.iterdir())]
    while True:
        content = kind.mutated(rng.choice(contents), rng)
        if farm.feed(content) and len(content) < LONGEST:
            contents.append(content)
            (corpus / sha256(content).hexdigest()[:16]).write_bytes(content)


def row_of(name: str, options: argparse.Namespace) -> dict[str, float]:
    """Runs a process for one kind and takes its figures; one that ended by itself is a find."""
    with TemporaryDirectory(prefix="rotorfit-fuzz-", dir=MEMORY) as folder:
        words = [sys.executable, __file__, name, "--worker", folder, "--keep", options.keep, "--corpus", options.corpus]
        words += ["--minutes", str(options.minutes), "--seed", str(options.seed)]
        try:
            code: int | str = subprocess.run(words, check=False, timeout=60 * options.minutes + 300).returncode
        except subprocess.TimeoutExpired:
            code = "hanging"
        figures = Path(folder) / "figures.json"
        if figures.is_file():
            return json.loads(figures.read_text())
        last = Path(folder) / "log"
        if last.is_file():
            Path(options.keep).mkdir(parents=True, exist_ok=True)
            (Path(options.keep) / f"{name}-{options.seed}-ended-with-{code}").write_bytes(last.read_bytes())
        print(f"{name}: the process ended with {code}", flush=True)
        return {"inputs": 0, "refused": 0, "ways": 0, "finds": 1, "seconds": 60 * options.minutes, "peak": 0}


def main() -> None:
    known = kinds()
    parser = argparse.ArgumentParser(description="Feeds rotorfit with mutated files and command lines.")
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"default: all ({', '.join(known)})")
    parser.add_argument("--minutes", type=float, default=10.0, help="for each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", default="fuzz-finds", metavar="FOLDER", help="for what goes wrong")
    parser.add_argument("--corpus", default="fuzz-corpus", metavar="FOLDER", help="goes on from there")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        (name,) = options.kinds
        corpus = Path(options.corpus) / name
        work(name, 60 * options.minutes, options.seed, Path(options.worker), Path(options.keep), corpus)
    totals = Path(options.corpus) / "counts.json"
    counts: Counter[str] = Counter(json.loads(totals.read_text()) if totals.is_file() else {})
    heads = ("kind", "inputs", "a second", "refused", "ways to end", "finds", "peak [MB]", "inputs so far")
    form = "{:15} {:>10} {:>9} {:>8} {:>12} {:>6} {:>10} {:>14}"
    wrong = 0.0
    print(form.format(*heads), flush=True)
    for name in options.kinds or known:
        row = row_of(name, options)
        counts[name] += int(row["inputs"])
        wrong += row["finds"]
        share = row["refused"] / max(1, row["inputs"])
        told = (name, int(row["inputs"]), f"{row['inputs'] / row['seconds']:.0f}", f"{share:.0%}", int(row["ways"]))
        print(form.format(*told, int(row["finds"]), f"{row['peak']:.0f}", counts[name]), flush=True)
        totals.write_text(json.dumps(counts))
    print(f"{counts.total()} inputs so far, {wrong:.0f} finds in this run")
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
