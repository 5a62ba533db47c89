"""How long does a fit take, against N4SID of the package nfoursid on the same x axis, in the same process?

    python bench/bench_fit_speed.py PATH/TO/bebop2-wsu/Training_CT_TestDay_X.mat

One thread; both after import and compilation; the best of several runs, and their ratios. Cold times are printed too.
"""

import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
RUNS = 5
DEFAULT = Path(__file__).resolve().parents[2] / "shared/data/bebop2-wsu/Training_CT_TestDay_X.mat"


def best_of(work: Callable[[], object]) -> float:
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT
    if not path.exists():
        print(f"skipped: {path} is not there; give the path of the X flight of bebop2-wsu")
        return
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read when numpy is first imported, below
    start = time.perf_counter()
    import numpy as np
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    from rotorfit.estimation.fitting import fit
    from rotorfit.files.cards import load_card
    from rotorfit.files.logs import read
    from rotorfit.flights.assemble import flight_from_log

    imported = time.perf_counter() - start
    flight = flight_from_log(read(path), load_card("bebop2-wsu"))
    start = time.perf_counter()
    fit([flight])
    first = time.perf_counter() - start

    grid = np.arange(flight.pose_time[0], flight.pose_time[-1], 1 / 20)
    held = np.clip(np.searchsorted(flight.command_time, grid, side="right") - 1, 0, None)
    position = np.interp(grid, flight.pose_time, flight.position[:, 0])
    table = pd.DataFrame({"u": flight.command[held, 0], "y": position})

    def n4sid() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = NFourSID(table, output_columns=["y"], input_columns=["u"], num_block_rows=15)
            model.subspace_identification()
            model.system_identification(rank=3)

    n4sid()
    reference = best_of(n4sid)
    print(f"{path.name}: {flight.duration:.0f} s, {flight.pose_time.size} poses")
    print(f"imports {imported:.2f} s; first fit in a process, compiled code from disk, {first:.2f} s")
    print(f"N4SID, order 3, 15 block rows, 20 Hz, x: {reference:.3f} s")
    for label, axes in (("x alone", ("x",)), ("all four axes", ("x", "y", "z", "yaw"))):
        taken = best_of(lambda axes=axes: fit([flight], axes=axes))
        print(f"likelihood with intervals, {label}: {taken:.3f} s, {taken / reference:.2f} times N4SID")
    command = [sys.executable, "-m", "rotorfit", "fit", str(path), "--card", "bebop2-wsu"]
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    print(f"whole command `rotorfit fit`, new process: {time.perf_counter() - start:.2f} s")


if __name__ == "__main__":
    main()
