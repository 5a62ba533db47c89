"""A studio that is killed at random moments of its writing, again and again; a process of its own, for it forks.

    python tests/studio_killed.py FOLDER TIMES SEED

Says how many changes were acknowledged and how many it was killed in; ends with 1 where one that was acknowledged is
lost, or the folder cannot be opened again.
"""

import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rotorfit.app.web import runner
from rotorfit.app.web.workspace import Session, Workspace
from rotorfit.files.cards import builtin_card_text
from studio_room import client_of, opened, settled

MOST = 4
"""Changes before the kill, at most."""


def content_of(name: str) -> bytes:
    """A log whose bytes its name tells."""
    rng = random.Random(name)
    rows = [f"{0.01 * i:.2f},{rng.random()},{rng.random()}" for i in range(rng.choice((20, 2000)))]
    return "\n".join(["time,x,y", *rows, ""]).encode()


def told_of(session: Session) -> dict[str, Any]:
    """What a user would miss."""
    logs = [[one.name, [part.role for part in one.ranges], one.ranges[0].start] for one in session.uploads]
    return {"card": session.card, "logs": logs, "fits": [one.id for one in session.fits]}


def asked(session: Session, rng: random.Random) -> tuple[tuple[str, str, Any], dict[str, Any]]:
    """A change of a session, and what the session is after it."""
    now, word = told_of(session), str(rng.randrange(10**9))
    kinds = ["card", "card"]
    kinds += ["upload"] * 4 if len(session.uploads) < 6 else ["remove"] * 4
    kinds += ["ranges"] * 2 if session.uploads else []
    kinds += ["fit"] if now["card"] and any(part == "train" for _, parts, _ in now["logs"] for part in parts) else []
    kinds += ["forget"] if any(one.status != "running" for one in session.fits) else []
    match rng.choice(kinds):
        case "card":
            text = f"# {word}\n{builtin_card_text('rotorfit-demo')}"
            return ("PUT", "/api/card", {"text": text, "seen": session.card_revision}), {**now, "card": text}
        case "upload":
            role = "validate" if any(part == "train" for _, parts, _ in now["logs"] for part in parts) else "train"
            return ("POST", f"/api/logs?name={word}.csv", content_of(f"{word}.csv")), {
                **now, "logs": [*now["logs"], [f"{word}.csv", [role], None]]
            }  # fmt: skip
        case "remove":
            at = rng.randrange(len(session.uploads))
            rest = [one for i, one in enumerate(now["logs"]) if i != at]
            return ("DELETE", f"/api/logs/{session.uploads[at].id}", {}), {**now, "logs": rest}
        case "ranges":
            at, start = rng.randrange(len(session.uploads)), float(word)
            one = session.uploads[at]
            logs = [[one.name, ["train"], start] if i == at else each for i, each in enumerate(now["logs"])]
            part = {"role": "train", "start": start, "end": None}
            body = {"ranges": [part], "seen": one.revision}
            return ("PUT", f"/api/logs/{one.id}/ranges", body), {**now, "logs": logs}
        case "fit":
            return ("POST", "/api/fits", {}), {**now, "fits": [*now["fits"], str(session.next_fit)]}
    fit = rng.choice([one.id for one in session.fits if one.status != "running"])
    return ("DELETE", f"/api/fits/{fit}", {}), {**now, "fits": [one for one in now["fits"] if one != fit]}


def change_for_ever(folder: Path, rng: random.Random, say: Callable[[str, Any], object]) -> None:
    """Changes a session, and says before and after each change what it is."""
    runner.sys = SimpleNamespace(executable="true")  # type: ignore[attr-defined]  # a fit that ends at once
    with opened(folder) as studio:
        page = client_of(studio)
        while True:
            (method, path, body), after = asked(studio.workspace.session, rng)
            say("asked", after)
            how = {"content": body} if isinstance(body, bytes) else {"json": body} if method != "DELETE" else {}
            answer = page.request(method, path, **how)
            assert answer.status_code in (200, 201), answer.text
            settled(studio)
            say("kept", after)


def killed(folder: Path, rng: random.Random) -> list[tuple[str, Any]]:
    """What a studio said until it was killed."""
    reading, writing = os.pipe()
    seed, changes, share = rng.random(), rng.randrange(MOST + 1), rng.random()
    child = os.fork()
    if not child:
        try:
            os.close(reading)
            change_for_ever(
                folder, random.Random(seed), lambda *said: os.write(writing, f"{json.dumps(said)}\n".encode())
            )
        finally:
            os._exit(1)
    os.close(writing)
    with os.fdopen(reading) as lines:
        said: list[tuple[str, Any]] = []
        begun = ended = time.monotonic()
        while sum(kind == "kept" for kind, _ in said) < changes:
            said.append(tuple(json.loads(lines.readline())))
            begun, ended = ended, time.monotonic()
        time.sleep(share * max(2 * (ended - begun), 0.05))  # somewhere in the next change, however busy the machine
        os.kill(child, signal.SIGKILL)
        assert os.waitpid(child, 0)[1] == signal.SIGKILL, "the studio ended by itself"
        said += [tuple(json.loads(line)) for line in lines if line.endswith("\n")]
    return said


def main(folder: Path, times: int, seed: int) -> None:
    rng, kept, inside = random.Random(seed), 0, 0
    state: dict[str, Any] = {"card": "", "logs": [], "fits": []}
    for time_ in range(times):
        said = killed(folder, rng)
        kept += sum(kind == "kept" for kind, _ in said)
        state = next((one for kind, one in reversed(said) if kind == "kept"), state)
        allowed = [state] + [one for kind, one in said[-1:] if kind == "asked"]
        inside += len(allowed) - 1
        workspace = Workspace(folder)
        found = told_of(workspace.session)
        for upload in workspace.session.uploads:
            assert workspace.path_of(upload).read_bytes() == content_of(upload.name), f"{time_}: {upload.name}"
        assert {one.name for one in (folder / "logs").iterdir()} == {one.id for one in workspace.session.uploads}
        workspace.close()
        assert not workspace.notice, workspace.notice
        assert found in allowed, f"kill {time_}: {found} is none of {allowed}"
        state = found
    print(json.dumps({"acknowledged": kept, "killed_inside": inside}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
