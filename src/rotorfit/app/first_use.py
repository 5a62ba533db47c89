"""Compiles the kernels that a fit or a tracker needs in parallel processes, once after an installation.

numba compiles each kernel when it is first called, one after the other, and caches it on the disk. Here each part calls
its kernels on a flight of six seconds; the parts are spread over the processors, and the compiled code is then loaded
from the cache. Any other call of a kernel compiles it as usual: this saves time and changes no result, but for rounding
where an inner function was inlined elsewhere.
"""

import gc
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING

from rotorfit.core import parallel
from rotorfit.core.call_stack import with_room
from rotorfit.core.progress import Progress

if TYPE_CHECKING:
    from rotorfit.core.flight_data import Flight

TEXT = "compiling {}, once after an installation"

PATIENCE = 120.0
"""Time after which the rest of the compiling is left to the fit itself [s]."""

_LOOK = 0.1


def compile_beforehand(wanted: Sequence[str], progress: Progress | None = None) -> None:
    """Compiles what is needed, if this installation has not done so yet.

    Args:
        wanted: Names of `PARTS`: `FITTING`, `VALIDATION` or `TRACKING`.
        progress: Called with a fraction and a text.
    """
    marks = {name: mark for name in wanted if not _compiled(mark := _mark(name))}
    if not marks or "NUMBA_DISABLE_JIT" in os.environ:
        return
    text = TEXT.format("the estimator" if marks.keys() & {*FITTING} else "what follows a vehicle")
    begun, running = perf_counter(), []
    try:
        for names in spread({name: PARTS[name][0] for name in marks}, parallel.processors()):
            words = [sys.executable, "-P", "-m", "rotorfit.app.first_use", *names]
            running.append(subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
        while any(one.poll() is None for one in running) and perf_counter() - begun < PATIENCE:
            if progress:
                progress(0.0, f"{text}: {perf_counter() - begun:.0f} s")
            sleep(_LOOK)
        if any(one.poll() is None for one in running):  # the next use goes on where this one stopped
            return
    except OSError:  # no process may be started: the fit compiles what it calls
        return
    finally:
        for one in running:
            if one.poll() is None:
                one.kill()
            one.wait()
    try:
        for mark in marks.values():
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()
    except OSError:
        return


def spread(costs: Mapping[str, float], processes: int) -> list[list[str]]:
    """Spreads parts over processes, the most expensive first, each to the process with the least work."""
    shares: list[list[str]] = [[] for _ in range(min(processes, len(costs)))]
    for name in sorted(costs, key=lambda name: -costs[name]):
        min(shares, key=lambda share: sum(costs[one] for one in share)).append(name)
    return shares


def _compiled(mark: Path) -> bool:
    """Whether a mark exists, and the compiled code too, which may have been deleted without the mark."""
    return mark.exists() and any(mark.parent.glob("*.nbi"))


def _mark(part: str) -> Path:
    """A file beside the compiled code: it exists once this numba and Python have compiled a part from these sources."""
    import numba

    from rotorfit.dynamics import kinematics

    sources = sorted(Path(kinematics.__file__).parent.glob("*.py"))
    of = [(path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in sources]
    versions = numba.__version__, sys.implementation.cache_tag
    token = hashlib.sha256(repr((of, versions)).encode()).hexdigest()[:16]
    return Path(str(kinematics._project.stats.cache_path)) / f"rotorfit-{token}-{part.replace(' ', '-')}.compiled"


def _prediction() -> None:
    """The prediction from many starts, its errors, and that without a disturbance."""
    import numpy as np

    from rotorfit.core.frames import AXES
    from rotorfit.dynamics.protocol import AxisDynamics, free_run_prediction, judged, predict_flight

    flight = _flight()
    dynamics = {axis: AxisDynamics(4.0, 1.0, 0.1, (0.1, 1e-6, 2.5, 0.6), 1e-6) for axis in AXES}
    for part in predict_flight(flight, dynamics, 0.5):
        judged(part, free_run_prediction(flight, part, np.ones(4), np.ones(4)), (0.5,))


def _likelihood(axes: tuple[str, ...], law: str) -> Callable[[], None]:
    """The likelihood of one axis, or of x and y, under a law."""

    def part() -> None:
        """Evaluates it once."""
        from rotorfit.core.laws import START_LEVELS, STRUCTURES
        from rotorfit.estimation.likelihood.block_response import response
        from rotorfit.estimation.likelihood.blocks import record
        from rotorfit.estimation.likelihood.likelihood import score
        from rotorfit.estimation.likelihood.optima import start_point
        from rotorfit.estimation.likelihood.richer_laws import starts

        rec = record(_flight(), axes)
        assert rec is not None
        point = start_point([rec], 0.1, 1.0, START_LEVELS[None].repeat(len(axes), axis=0))
        if law == "first_order_delay":
            score([rec], point)
        else:
            point = starts([rec], point, 0, STRUCTURES[law])[0]
            response(rec, point, 0, point.start)

    return part


def _limits() -> None:
    """The motion under a limited acceleration, by which the law is tested."""
    import numpy as np

    from rotorfit.core.laws import FIRST_ORDER_DELAY, law_of
    from rotorfit.dynamics.limited_motion import limited_motion

    law = law_of(FIRST_ORDER_DELAY, 4.0, 1.0, 0.1, {})[None]
    limited_motion(0.01, np.ones((9, 1)), np.zeros(9), law, np.zeros(1))


def _motion() -> None:
    """The motion from pose to pose, and a disturbance, as a tracker follows them."""
    import numpy as np

    from rotorfit.core.laws import FIRST_ORDER_DELAY, law_of
    from rotorfit.dynamics.disturbance import distinct_steps, step_tables
    from rotorfit.dynamics.disturbance_state import disturbance_states
    from rotorfit.dynamics.motion_filter import motion_filter

    flight = _flight()
    commands, poses = (flight.command_time, flight.command), (flight.pose_time, flight.position, flight.yaw)
    laws = np.array([law_of(FIRST_ORDER_DELAY, 4.0, 1.0, 0.1, {})] * 2)
    levels, at_rest = np.array([[0.1, 1e-6, 2.5, 0.6]] * 2), np.zeros(2)
    running = motion_filter(0.0, at_rest, at_rest, 0.0, *commands, laws, levels, np.ones(2, dtype=bool), True)
    running.follow(*poses, *commands)
    running.motion(*commands)
    steps, step = distinct_steps(flight.pose_time)
    disturbance_states(steps, step, flight.yaw, np.ones(flight.yaw.size), levels[0])
    step_tables(steps, *levels[0, 2:])


def _checks() -> None:
    """The checks before a fit."""
    from rotorfit.diagnosis.command_response import answers_of
    from rotorfit.diagnosis.pose_checks import leaps

    flight = _flight()
    leaps(flight.pose_time, flight.position, (0.1, 1.0), (0.1, 1.0))
    answers_of(flight)


PARTS: Mapping[str, tuple[float, Callable[[], None]]] = {
    "prediction": (8.0, _prediction),
    "general law": (1.0, _likelihood(("x", "y"), "second_order")),
    "plane": (5.0, _likelihood(("x", "y"), "first_order_delay")),
    "axis": (2.5, _likelihood(("z",), "first_order_delay")),
    "lag": (1.3, _likelihood(("z",), "second_order")),
    "checks": (1.0, _checks),
    "limits": (1.0, _limits),
    "motion": (7.0, _motion),
}
"""What is compiled, about how long it takes [s], and what calls it."""

FITTING = "prediction", "general law", "plane", "axis", "lag", "checks", "limits"
VALIDATION = "prediction", "axis", "lag", "checks"
TRACKING = *FITTING, "motion"
"""What a fit calls of it, what a validation, and what a tracker, which fits, too."""


def _flight() -> "Flight":
    """A flight of six seconds in which every axis is commanded and the vehicle turns."""
    import numpy as np

    from rotorfit.core.flight_data import Flight, Segment
    from rotorfit.core.frames import AXES
    from rotorfit.files.cards import builtin_cards

    commands, poses = np.arange(0.0, 6.0, 0.05), np.arange(0.0, 6.0, 0.02)
    waves = np.sin(np.outer(poses, [1.0, 1.3, 1.7, 2.1]))
    return Flight(
        path="", sha256="", card=next(iter(builtin_cards().values())), span=(0.0, 6.0), axes=AXES,
        command_time=commands, command=np.sin(np.outer(commands, [1.1, 1.4, 1.8, 2.2])), pose_time=poses,
        position=np.ascontiguousarray(waves[:, :3]), yaw=waves[:, 3].copy(), segments=(Segment(0.0, 6.0),),
    )  # fmt: skip


def main(names: Sequence[str]) -> None:
    """Compiles some parts, in a process that does nothing else."""
    gc.disable()  # compiling makes many long-lived objects: garbage collection would take a tenth of the time
    for name in names:
        with_room(PARTS[name][1])


if __name__ == "__main__":
    main(sys.argv[1:])
