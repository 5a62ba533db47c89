"""How fluid is the studio with a million poses?

    python bench/bench_studio.py [--keep FOLDER]

Simulates a flight of 5,000 s with poses at 200 Hz and commands at 20 Hz (seed 1), writes it as CSV, starts the studio
in a process of its own and drops the log into headless Chromium. Times are wall-clock times; the server's memory is as
Linux counts it for its process. One run, 800 pixels wide, windows from a seed.
"""

import argparse
import json
import shutil
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx2 as httpx
import numpy as np
import polars as pl

from rotorfit.simulation.paper_vehicle import Controller, Truth, simulate_flight

DURATION, RATE, SEED, WIDTH, WINDOWS = 5000.0, 200.0, 1, 800, 200
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
FLAGS += ["--disable-background-networking", "--disable-component-update"]


def write_log(path: Path) -> int:
    """A CSV of poses and commands, blank where a row has none; returns the number of poses."""
    level = np.random.default_rng(SEED).integers(-1, 2, (10_000, 4)) * 0.2

    def command(t: np.ndarray) -> np.ndarray:
        return level[np.maximum(t / 0.7, 0).astype(int)]

    truth = replace(Truth(), pose_rate=RATE, command_rate=20.0)
    flight = simulate_flight(truth, command, DURATION, SEED, controller=Controller(0.3, 0.5))
    pose = dict(zip(("x", "y", "z", "yaw"), flight.pose.T, strict=True))
    sent = dict(zip(("cmd_x", "cmd_y", "cmd_z", "cmd_yaw"), flight.command.T, strict=True))
    tables = [
        pl.DataFrame({"time": flight.pose_stamp / 1e9, **pose}),
        pl.DataFrame({"time": flight.command_stamp / 1e9, **sent}),
    ]
    pl.concat(tables, how="diagonal").sort("time").write_csv(path, float_precision=5)
    return flight.pose_stamp.size


@contextmanager
def running(folder: Path) -> Iterator[tuple[str, int]]:
    """Address and process of a studio."""
    command = [sys.executable, "-m", "rotorfit", "studio", str(folder), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said = ""
        while not said.rstrip().endswith("}"):
            said += process.stdout.readline()
        yield json.loads(said)["address"], process.pid
        process.send_signal(signal.SIGINT)


def memory(pid: int, what: str = "VmRSS") -> float:
    """MiB of a process."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(what))


def timed(act: Callable[[], Any]) -> tuple[float, Any]:
    began = time.perf_counter()
    found = act()
    return time.perf_counter() - began, found


def server(address: str, pid: int, log: Path) -> dict[str, Any]:
    """The log through the API."""
    token = parse_qs(urlsplit(address).query)["token"][0]
    base = address.partition("/?")[0]
    client = httpx.Client(base_url=base, headers={"authorization": f"Bearer {token}"}, timeout=600)
    out: dict[str, Any] = {"memory_empty_mib": memory(pid)}

    def ok(answer: httpx.Response) -> httpx.Response:
        assert answer.status_code < 300, answer.text
        return answer

    data = log.read_bytes()
    out["upload_and_read_s"], answer = timed(lambda: ok(client.post("/api/logs?name=long.csv", content=data)))
    place = f"/api/logs/{answer.json()['id']}"
    out["tables_s"], _ = timed(lambda: ok(client.get(place)))
    out["first_column_s"], _ = timed(lambda: ok(client.get(f"{place}/column?source=x&width={WIDTH}")))
    out["draft_s"], _ = timed(lambda: ok(client.put("/api/card", json={"draft": answer.json()["id"], "seen": 0})))
    out["flight_s"], _ = timed(lambda: ok(client.get(f"{place}/flight")))
    out["first_motion_s"], _ = timed(lambda: ok(client.get(f"{place}/motion?axis=x&width={WIDTH}")))
    windows = random_windows(f"{place}/motion?axis=x&width={WIDTH}")
    with ThreadPoolExecutor(1) as pool:  # panning while the server looks for findings
        waiting = pool.submit(timed, lambda: ok(client.get(f"{place}/findings")))
        seconds = []
        while not waiting.done():
            seconds.append(timed(lambda: ok(client.get(next(windows))))[0])
        out["findings_s"], _ = waiting.result()
    out["window_while_looking_for_findings_ms"] = quantiles(seconds)
    out["window_ms"] = quantiles([timed(lambda: ok(client.get(next(windows))))[0] for _ in range(WINDOWS)])
    out["window_whole_ms"] = quantiles(
        [timed(lambda: ok(client.get(f"{place}/motion?axis=x&width={WIDTH}")))[0] for _ in range(20)]
    )
    out["memory_mib"], out["memory_peak_mib"] = memory(pid), memory(pid, "VmHWM")
    return out


def random_windows(address: str) -> Iterator[str]:
    """Windows of 1 s to the whole flight, anywhere."""
    rng = np.random.default_rng(SEED)
    while True:
        length = float(np.exp(rng.uniform(0.0, np.log(DURATION))))
        start = rng.uniform(0, DURATION - length)
        yield f"{address}&from={start}&to={start + length}"


def quantiles(seconds: list[float]) -> dict[str, float]:
    return {"median": 1e3 * statistics.median(seconds), "p95": 1e3 * float(np.quantile(seconds, 0.95))}


FRAMES = """async () => {
  const place = document.querySelector("#ranges .plot"), gaps = [];
  let last = performance.now();
  for (let i = 0; i < 120; i++) {
    if (i % 4 === 0) place.dispatchEvent(new KeyboardEvent("keydown", {key: i % 24 < 12 ? "ArrowRight" : "ArrowLeft"}));
    await new Promise(requestAnimationFrame);
    const now = performance.now();
    gaps.push((now - last) / 1e3);
    last = now;
  }
  return gaps;
}"""


def browser(address: str, log: Path) -> dict[str, Any]:
    """The same log dropped into a browser."""
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=300_000)
    out: dict[str, Any] = {}
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        page = chromium.new_page(viewport={"width": 1280, "height": 860})
        page.goto(address)
        expect(page.locator("html[data-ready]")).to_have_count(1)

        def first() -> None:
            page.set_input_files("#file-picker", log)
            expect(page.locator("#logs .plot canvas").first).to_be_visible()

        out["drop_to_first_plot_s"], _ = timed(first)
        page.get_by_role("navigation").get_by_text("Ranges").click()
        out["ranges_first_plot_s"], _ = timed(lambda: expect(page.locator("#ranges .plot canvas")).to_be_visible())
        page.wait_for_timeout(3000)
        for _ in range(4):
            page.locator("#ranges .plot").focus()
            page.keyboard.press("+")
            page.wait_for_timeout(300)
        page.evaluate("() => performance.clearMeasures()")
        gaps = page.evaluate(FRAMES)
        page.wait_for_timeout(500)
        for key in ("+", "+", "ArrowRight", "-", "ArrowLeft", "0", "+", "+", "+", "+", "+", "+", "-", "0") * 2:
            page.locator("#ranges .plot").focus()
            page.keyboard.press(key)
            page.wait_for_timeout(250)
        measures = page.evaluate("() => performance.getEntriesByName('rotorfit-plot').map(one => one.duration / 1e3)")
        out["frame_while_panning_ms"] = quantiles(gaps)
        out["request_to_drawn_ms"] = quantiles(measures)
        out["requests"] = len(measures)
        out["heap_mib"] = page.evaluate("() => performance.memory.usedJSHeapSize / 2 ** 20")
        chromium.close()
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", type=Path, help="folder for the log; one that is there is used again")
    keep = parser.parse_args().keep
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        log = (keep or folder) / "long.csv"
        if not log.exists():
            write_log(log)
        out: dict[str, Any] = {"log_mib": log.stat().st_size / 2**20}
        with running(folder / "server") as (address, pid):
            out |= server(address, pid, log)
        with running(folder / "browser") as (address, pid):
            out["browser"] = browser(address, log)
            out["browser"]["server_memory_mib"] = memory(pid)
    print(json.dumps(out, indent=1))


if __name__ == "__main__":
    main()
