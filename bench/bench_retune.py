"""Does re-tuning in flight perform as well as gains for the true vehicle? A vehicle that changes half-way.

    python bench/bench_retune.py [SEEDS] [--structure S] [--only "SHAPE CHANGE;SHAPE CHANGE"]

A Bebop 2 of the flight room follows a circle (1 m) or a lemniscate (1.2 m) at 1 m/s in the wind of its seed: a mean of
1 to 2 m/s from any horizontal direction, Dryden gusts of 0.3, 0.3 and 0.15 m/s. At `AT` it changes: a payload of 30 %
of its mass is taken up, its tilt limit goes from 10 to 15 degrees, or commands come 50 ms later. Only the path and the
wind excite it. Four flights with the same wind and noise:

kept        gains from a model of the vehicle before the change, with errors of the size of `DOUBT`, to the end
re-tuned    the same, until re-tuning, which starts from that model and receives poses and commands, publishes others
true        at each re-tuning gains for the true vehicle after the change, with the bandwidth that re-tuning chose
known       from the change on, gains for the true vehicle after it, with the margins for such a doubt

Re-tuned against true is the cost of the estimates, true against known the cost of the doubt. Printed: when and why each
axis was re-tuned; root mean square distance from the path, from `SETTLE` after the last new gains to the end, in the
same window for all four. Last comes a flight whose commands stop before the payload is taken up: nothing may be
published after that.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.control.control_law import AxisLaw
from rotorfit.control.controller import AxisControllers, ReferencePath, at_rest, commanded, observe
from rotorfit.control.retuning import Flown, Retuning
from rotorfit.control.trial import controller_of
from rotorfit.control.tuning import Tuning, tune
from rotorfit.core.frames import AXES, Array, yaw_from_quaternion
from rotorfit.core.log import Sample
from rotorfit.core.model import COEFFICIENTS, Axis, Model, Predictor
from rotorfit.core.tracked import Tracked
from rotorfit.files.cards import card_from_mapping
from rotorfit.simulation.air import Gusts, Wind
from rotorfit.simulation.change import Change, changed
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.vehicle import Vehicle, load_vehicle
from rotorfit.tracking.tracker import Tracker

AT, LENGTH, SETTLE = 45.0, 105.0, 3.0
"""When the vehicle changes; length of a flight; after new gains, until errors count [s]."""

CHANGES: Mapping[str, Change] = {
    "payload": Change(AT, mass=1.3),
    "limits": Change(AT, tilt=float(np.radians(15.0))),
    "delay": Change(AT, latency=0.05),
}

SIZES = {"circle": 1.0, "lemniscate": 1.2}

NAMES = ("kept", "re-tuned", "true", "known")

Later = tuple[float, Mapping[str, AxisLaw]]
"""An instant [s], and the laws that are flown from then on."""

DOUBT: Mapping[str, float] = {"input": 0.03, "damping": 0.10, "delay": 0.010}
"""Standard errors of a vehicle that was identified well: of its input and damping relative, of its delay [s]."""

LEAST = 15.0
"""Flight that must be left after the last new gains; what comes later is for the next flight [s]."""

STOPPED = 35.0
"""When the commands of the last flight stop [s]."""


@dataclass(frozen=True)
class Flight:
    """One flight: distance from the path at each command, and the gains that were published, and when."""

    error: Array
    published: tuple[tuple[float, Tuning], ...] = ()


def vehicle_of(change: str) -> Vehicle:
    """The Bebop 2 with a battery that lasts; its first tilt limit where that changes."""
    vehicle = load_vehicle("bebop2")
    battery = replace(vehicle.battery, sag=0.0, flight_time=1e9)
    vehicle = replace(
        vehicle, battery=battery, autopilot=replace(vehicle.autopilot, brakes_on_zero=False, learning=1.0)
    )
    if change == "limits":
        return replace(vehicle, command=replace(vehicle.command, tilt=float(np.radians(10.0))))
    return vehicle


def model_of(vehicle: Vehicle, full_scale: Vehicle, seed: int | None) -> Model:
    """A model of a vehicle, known as `DOUBT` says.

    Args:
        vehicle: What it is.
        full_scale: What a command of 1 is, is said by another's card.
        seed: Of its errors; None for none.
    """
    linear, card = vehicle.linear(), card_from_mapping(full_scale.card(), full_scale.name)
    axes, names = {}, []
    for k, axis in enumerate(AXES):
        true = np.array([linear.gamma[2 * k], linear.gamma[2 * k + 1], linear.delay[k]])
        size = np.array(list(DOUBT.values())) * (abs(true[0]), abs(true[1]), 1.0)
        off = 0.0 if seed is None else np.random.default_rng((3, seed, k)).standard_normal(3) * size
        point = Predictor(*(true + off).tolist())
        values = {name: getattr(point, name) for name in COEFFICIENTS}
        errors = dict(zip(COEFFICIENTS, size.tolist(), strict=True))
        ends = {name: (value - 2 * errors[name], value + 2 * errors[name]) for name, value in values.items()}
        status = dict.fromkeys(COEFFICIENTS, "ok")
        axes[axis] = Axis(**values, stderr=errors, ci95=ends, status=status, predictor=point)
        names += [f"{axis}.{name}" for name in COEFFICIENTS]
    errors = np.array([axes[name.partition(".")[0]].stderr[name.partition(".")[2]] for name in names])
    return Model(card, "first_order_delay", "ml", axes, tuple(names), np.diag(errors**2), (None,) * 8, (), ())


def flown(
    change: str, path: ReferencePath, seed: int, before: Model, later: Sequence[Later] = (),
    structure: str | None = None, commands_until: float = LENGTH,
) -> Flight:  # fmt: skip
    """Flies a path.

    Args:
        change: What happens to the vehicle.
        path: To be followed.
        seed: Of the wind and all noise.
        before: From which the gains at the start are tuned, and which the tracker comes after.
        later: Laws that are flown from some instants on.
        structure: Law of the tracker whose gains are taken over; None for no tracker.
        commands_until: From then on nothing is commanded [s].
    """
    rng, vehicle = np.random.default_rng((2, seed)), vehicle_of(change)
    speed, angle = rng.uniform(1.0, 2.0), rng.uniform(0.0, 2.0 * np.pi)
    wind = Wind((float(speed * np.cos(angle)), float(speed * np.sin(angle)), 0.0), Gusts((0.3, 0.3, 0.15)))
    room = FlightRoom(vehicle, Conditions(wind, floor=-1e6, changes=(CHANGES[change],)), seed, path.start)
    gains = tune(before)
    controller, steering, errors = controller_of(gains, vehicle), at_rest(np.array(path.start)), []
    follower = Follower(vehicle, before, gains, structure) if structure else None
    for k in range(round(path.duration / controller.period)):
        t = k * controller.period
        for since, laws in later:
            if since <= t < since + controller.period:
                controller = AxisControllers({**controller.laws, **laws}, controller.full_scale)
        poses = [sample for sample in room.advance(round(t * 1e9)) if sample.stream == "pose"]
        if poses:
            steering = observe(controller, steering, poses[-1].stamp * 1e-9, _pose(poses[-1]), path)
        steering, command = commanded(controller, steering, t, path)
        if t < commands_until:
            room.send(command.tolist())
        else:
            command = np.zeros(4)
            room.send([0.0] * 4)
        if follower and (laws := follower.hears(poses, t, command)):
            controller = AxisControllers({**controller.laws, **laws}, controller.full_scale)
        errors.append(float(np.linalg.norm(np.array(room.truth().position) - path.at(np.array([t]))[0][0, :3])))
    return Flight(np.array(errors), tuple(follower.published) if follower else ())


class Follower:
    """`rotorfit track --after --tune` beside a flight: hears samples, gives gains back."""

    def __init__(self, vehicle: Vehicle, before: Model, gains: Tuning, structure: str) -> None:
        self._tracker = Tracker(card_from_mapping(vehicle.card(), vehicle.name), structure, origin=0, after=before)
        flown = {axis: Flown(one.law, one.bandwidth) for axis, one in gains.axes.items()}
        self._retuning, self._last = Retuning(flown=flown, before=before), self._tracker.state()
        self.published: list[tuple[float, Tuning]] = []

    def hears(self, poses: list[Sample], t: float, command: Array) -> dict[str, AxisLaw]:
        """Samples up to an instant [s]; the gains that they call for."""
        for pose in poses:
            self._tracker.update(pose)
        self._tracker.update(Sample("command", round(t * 1e9), round(t * 1e9), tuple(command.tolist())))
        state = self._tracker.state()
        if state is self._last:
            return {}
        self._last = state
        return self._looked(state)

    def _looked(self, state: Tracked) -> dict[str, AxisLaw]:
        for alarm in state.alarms:
            print(f"    {state.time:5.1f} s alarm {', '.join(alarm.axes)}: {alarm.cause}", flush=True)
            self._retuning.changed(alarm.axes, alarm.cause, alarm.revises is not None)
        words = ("known", "not_identifiable")
        told = [[axis for axis, one in state.axes.items() if one.knowledge == word] for word in words]
        found = self._retuning.look(state.model, *told) if state.model else None
        if found is None:
            return {}
        self.published.append((state.time, found.tuning))
        for axis, why in found.why.items():
            print(f"    {state.time:5.1f} s {axis}: {found.tuning.axes[axis].bandwidth:.2f} rad/s, {why}", flush=True)
        return {axis: one.law for axis, one in found.tuning.axes.items()}


def _pose(sample: Sample) -> Array:
    return np.array([*sample.values[:3], float(yaw_from_quaternion(*map(np.array, sample.values[3:7])))])


def as_fast(vehicle: Vehicle, tuning: Tuning) -> dict[str, AxisLaw]:
    """Laws of a vehicle that is known, with the bandwidths of others."""
    linear, out = vehicle.linear(), {}
    for axis, one in tuning.axes.items():
        k, w = AXES.index(axis), one.bandwidth
        gain, damping, delay = linear.gamma[2 * k], linear.gamma[2 * k + 1], linear.delay[k]
        rate = max(2 * w - damping, 0.0)
        stiffness = w * (damping + rate - w)
        out[axis] = replace(one.law, input=gain, damping=damping, delay=delay, stiffness=stiffness, rate=rate)
    return out


def compared(shape: str, change: str, seed: int, structure: str) -> tuple[float, ...] | None:
    """Errors of kept, re-tuned, true and known gains [m]; None where nothing was published after the change."""
    path = ReferencePath(shape, SIZES[shape], 1.0, LENGTH)  # type: ignore[arg-type]
    vehicle = vehicle_of(change)
    then = changed(vehicle, [CHANGES[change]])
    before, after = model_of(vehicle, vehicle, seed), tune(model_of(then, vehicle, None))
    print(f"{shape}, {change}, seed {seed}:", flush=True)
    retuned = flown(change, path, seed, before, structure=structure)
    earlier = [(time, {axis: one.law for axis, one in new.axes.items()}) for time, new in retuned.published]
    new = [(time, tuning) for time, tuning in retuned.published if AT < time < LENGTH - LEAST]
    begun = new[-1][0] if new else AT + 20.0
    true = [*(each for each in earlier if each[0] <= AT), *((time, as_fast(then, tuning)) for time, tuning in new)]
    known = [(AT, {axis: one.law for axis, one in after.axes.items()})]
    others = [flown(change, path, seed, before, later) for later in ((), true, known)]
    counted = np.arange(retuned.error.size) * (path.duration / retuned.error.size) >= begun + SETTLE
    every = (others[0], retuned, *others[1:])
    errors = tuple(float(np.sqrt(np.mean(one.error[counted] ** 2))) for one in every)
    found = "" if new else "  (nothing published after the change)"
    words = ", ".join(f"{name} {100 * each:.1f}" for name, each in zip(NAMES, errors, strict=True))
    print(f"  from {begun + SETTLE:.0f} s: {words} cm{found}", flush=True)
    return errors if new else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("seeds", nargs="?", type=int, default=3)
    parser.add_argument("--structure", default="averaged")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    every = [f"{shape} {change}" for change in CHANGES for shape in SIZES]
    wanted = [each for each in given.only.split(";") if each] or every
    for name in wanted:
        shape, change = name.split()
        found = [compared(shape, change, 1 + seed, given.structure) for seed in range(given.seeds)]
        told = np.array([one for one in found if one])
        if told.size:
            kept, ours = (np.median(told[:, k] / told[:, 2]) for k in (0, 1))
            known, before = (np.median(told[:, k] / told[:, 3]) for k in (1, 0))
            print(
                f"{name}: re-tuned over true {ours:.2f}, kept over true {kept:.2f}; re-tuned over known {known:.2f}, "
                f"kept over known {before:.2f} (medians of {len(told)} of {given.seeds})\n"
            )
    path, vehicle = ReferencePath("circle", 1.0, 1.0, LENGTH), vehicle_of("payload")
    print(f"circle whose commands stop at {STOPPED:g} s, payload at {AT:g} s:", flush=True)
    silent = flown("payload", path, 1, model_of(vehicle, vehicle, 1), (), given.structure, STOPPED)
    late = [time for time, _ in silent.published if time > STOPPED]
    print(f"  {len(late)} publications after the commands have stopped")


if __name__ == "__main__":
    main()
