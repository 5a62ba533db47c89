"""Mutated logs of every format: does reading ever crash, hang or fill the memory?

    python bench/fuzz.py [--minutes 10] [--seed 0] [--keep FOLDER] [FORMAT...]

Takes the small files that the tests write (`WRITERS` in `tests/files/test_sources.py`), changes them at random and
reads them in a process of its own for so many minutes a format. What goes wrong is kept in FOLDER: a process that ended
by a signal, an exception that is no LogError, an error of several lines, more than 10 s of processor time, more than
1 GB. Ends with 1 if anything did.
"""

import argparse
import random
import resource
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

TESTS = Path(__file__).resolve().parents[1] / "tests/files"
SECONDS, MEGABYTES = 10, 1000
EXTREMES = (b"\0", b"\xff", b"\x7f", b"\x80", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0\0\0\0\0")


def mutated(content: bytes, rng: random.Random) -> bytes:
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


def samples(name: str, folder: Path) -> list[bytes]:
    """Files of a format as the tests write them, those of folders by their storage."""
    sys.path[:0] = [str(TESTS), str(TESTS.parent)]
    from test_sources import WRITERS, recording

    found = []
    for case, (kind, write) in WRITERS.items():
        if kind == name:
            path = write(folder / f"{len(found)}_{case.replace(' ', '_')}", recording())
            files = [path] if path.is_file() else [file for file in path.iterdir() if file.name != "metadata.yaml"]
            found += [file.read_bytes() for file in files]
    return found


def peak() -> float:
    """Largest memory of this process or one that it started, so far [MB]."""
    who = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(one).ru_maxrss for one in who) / 1e3


def work(name: str, seconds: float, seed: int, folder: Path, keep: Path) -> int:
    """Reads mutated files of a format; says how they went; returns how many went wrong."""
    from rotorfit.core.errors import LogError
    from rotorfit.files.logs import read

    def overdue(*_: object) -> None:
        raise TimeoutError(f"more than {SECONDS} s of processor time")

    signal.signal(signal.SIGPROF, overdue)
    rng, contents, path = random.Random(seed), samples(name, folder), folder / "log"
    ends: Counter[str] = Counter()
    wrong, start = 0, time.monotonic()
    while time.monotonic() < start + seconds:
        path.write_bytes(mutated(rng.choice(contents), rng))
        fault, limit = "", max(MEGABYTES, peak())
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            log = read(path)
            ends["read with a note" if log.notes or log.damage else "read"] += 1
        except LogError as error:
            ends["refused"] += 1
            fault = "an error of several lines" if "\n" in str(error) else ""
        except Exception as error:  # noqa: BLE001 - whatever it is, it is what is looked for
            fault = f"{type(error).__name__}: {error}"
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        if not fault and peak() > limit:
            fault = f"{peak():.0f} MB"
        if fault:
            wrong += 1
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"{name}-{seed}-{wrong}").write_bytes(path.read_bytes())
            print(f"  {name}: {fault.splitlines()[0]}", flush=True)
    parts = ", ".join(f"{count} {what}" for what, count in ends.most_common())
    print(f"{name}: {sum(ends.values())} files, {parts}; {wrong} wrong; peak {peak():.0f} MB", flush=True)
    return wrong


def main() -> None:
    from rotorfit.files.logs import FORMATS

    parser = argparse.ArgumentParser(description="Reads mutated logs of every format.")
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=f"default: all ({', '.join(FORMATS)})")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-finds"))
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        with TemporaryDirectory(prefix="rotorfit-fuzz-", dir=options.worker) as folder:
            sys.exit(work(options.formats[0], 60 * options.minutes, options.seed, Path(folder), options.keep) > 0)
    wrong = False
    for name in options.formats or FORMATS:
        with TemporaryDirectory(prefix="rotorfit-fuzz-") as folder:
            command = [sys.executable, __file__, name, "--worker", folder, "--keep", str(options.keep)]
            command += ["--minutes", str(options.minutes), "--seed", str(options.seed)]
            code = subprocess.run(command, check=False).returncode
            wrong |= code != 0
            if code not in (0, 1):
                options.keep.mkdir(parents=True, exist_ok=True)
                for last in Path(folder).glob("*/log"):
                    (options.keep / f"{name}-{options.seed}-ended-by-{-code}").write_bytes(last.read_bytes())
                print(f"{name}: the process ended with {code}", flush=True)
    sys.exit(wrong)


if __name__ == "__main__":
    main()
