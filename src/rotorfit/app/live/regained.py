"""New gains while a vehicle flies: published as a message and, if wanted, as a file; nothing is ever commanded."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rotorfit.app.workflows import check_destination
from rotorfit.assessment.summary import spoiled
from rotorfit.control.retuning import Flown, Retuned, Retuning
from rotorfit.control.tuning import LATENCY
from rotorfit.core.finding import WRONG_FRAME
from rotorfit.core.frames import AXES
from rotorfit.core.frozen import frozen_axes
from rotorfit.core.model import FROZEN, Model
from rotorfit.core.tracked import UNMOVED, Alarm, Tracked, TrackedAxis
from rotorfit.exports.gains import GAINS_MARK, check_gains_name, law_of, read_gains, tuning_mapping, write_gains
from rotorfit.tracking.earlier import Earlier

OF_THE_VEHICLE = ("payload", "thrust", "limits", "delay", "other")
"""Causes of alarms that mean a change of the vehicle itself."""

Message = Mapping[str, Any]


def regaining_of(
    path: str, told: Callable[[Message, int], None], kept: Callable[[Path | None], None], earlier: Earlier | None
) -> "Regaining":
    """Publishes new gains beside a tracker.

    Args:
        path: Path of the gains file; empty for messages alone.
        told: As for `Regaining`, likewise `kept`.
        kept: Called with the path of the backup.
        earlier: The model of an earlier flight; None if there is none.
    """
    return Regaining(Path(path) if path else None, told, kept, earlier)


class Regaining:
    """Watches the states of a vehicle, and publishes new gains.

    The gains in the file at the start are taken as those in use, and its design, rate and latency are kept.

    Args:
        path: Path of the gains file, TOML or YAML; None for messages alone.
        listener: The first of the listeners.
        kept: Called with the path of the backup when the original file is first replaced.
        earlier: The model of an earlier flight; None if there is none.

    Attributes:
        listeners: Called with each message and the link's clock [ns].
        published: Time [s] and axes of each message so far.

    Raises:
        ModelError: The file's name has another suffix, or the gains file cannot be read.
        LogError: The path is taken by something else.
    """

    def __init__(
        self,
        path: Path | None,
        listener: Callable[[Message, int], None],
        kept: Callable[[Path | None], None],
        earlier: Earlier | None = None,
    ) -> None:
        self._path, self.listeners, self._kept = path, [listener], kept
        self._earlier, self._replaced = earlier, False
        self.published: list[tuple[float, Sequence[str]]] = []
        self._changed: dict[str, tuple[Alarm, float]] = {}  # the last alarm of each axis, and when it named that
        self._unchanged = self._changed  # as before the last alarm
        self._state = Tracked(0.0, {})
        self._gains: dict[str, Any] = {"design": "predictor", "rate": None, "latency": LATENCY, "axes": {}}
        if path:
            check_gains_name(path)
            check_destination(path, GAINS_MARK)
            self._gains = read_gains(path) if path.exists() else self._gains
        self._retuning = self._begun()

    def _begun(self) -> Retuning:
        """What decides, with the gains that are in use."""
        flown = {axis: Flown(law_of(self._gains, axis), float(one["bandwidth"])) for axis, one in self._axes()}
        loop = self._gains["design"], self._gains["rate"], self._gains["latency"]
        known = (self._earlier.model, self._earlier.name) if self._earlier else ()
        return Retuning(*loop, flown, *known)

    def memory(self) -> dict[str, Any]:
        """What `recall` of another one continues from, as plain types of JSON."""
        return {"gains": self._gains, "published": self.published, "replaced": str(self._path) * self._replaced}

    def recall(self, changes: Collection[Alarm], another: bool, memory: Mapping[str, Any] | None) -> None:
        """Continues in a flight that another tracker has begun; call it before the first state.

        Args:
            changes: The alarms of the flight so far.
            another: Whether the vehicle was found not to be that of the earlier model.
            memory: What `memory` returned; None of a file without it. Gains in the gains file come first.
        """
        if memory:
            self.published = [(time, tuple(axes)) for time, axes in memory["published"]]
            self._gains = self._gains if self._axes() else dict(memory["gains"])
            self._replaced = self._path is not None and memory["replaced"] == str(self._path)
            self._retuning = self._begun()
        for alarm in changes:
            self._note(replace(alarm, time=alarm.raised, revises=None))
        self._retuning.retuned(axis for axis, time in self._last.items() if time > self._changed_at(axis))
        if another:
            self._retuning.another()

    def _note(self, alarm: Alarm) -> None:
        """Takes an alarm."""
        if alarm.cause == "another_vehicle":
            self._retuning.another()
            self._changed = self._unchanged = {**self._changed, **dict.fromkeys(AXES, (alarm, alarm.time))}
        if alarm.cause in OF_THE_VEHICLE or alarm.turned:
            again, alarm = alarm.revises is not None, replace(alarm, axes=("x", "y")) if alarm.turned else alarm
            self._retuning.changed(alarm.axes, alarm.cause, again)
            if not again:
                self._unchanged = self._changed
            named = {axis: at for axis, (one, at) in self._changed.items() if one.raised == alarm.raised}
            changed = {axis: (alarm, named.get(axis, alarm.time)) for axis in alarm.axes}
            self._changed = {**self._unchanged, **changed}

    def _changed_at(self, axis: str) -> float:
        """When the last alarm about an axis named it [s]; -inf if there is none."""
        return self._changed[axis][1] if axis in self._changed else -math.inf

    @property
    def _last(self) -> dict[str, float]:
        """Axis to the time of its last new gains [s]."""
        return {axis: time for time, axes in self.published for axis in axes}

    def state(self, state: Tracked, now: int) -> None:
        """Publishes new gains if a state calls for them."""
        for alarm in state.alarms:
            self._note(alarm)
        self._state = state
        if state.model is None or state.landed:
            return
        axes = {
            word: [axis for axis, one in state.axes.items() if one.knowledge == word]
            for word in ("known", "not_identifiable")
        }
        doubted = any(one.contradicts for one in state.axes.values())
        found = self._retuning.look(state.model, axes["known"], axes["not_identifiable"], doubted, self._misread)
        if found:
            self._publish(found, state.model, state.time, now)

    @property
    def _misread(self) -> dict[str, str]:
        """Axis to why its numbers may not be the vehicle's: the frame is wrong, or not checked yet."""
        if self._state.findings is None:
            return dict.fromkeys(("x", "y"), "it is not known yet whether its commands act along the heading")
        wrong = *WRONG_FRAME, FROZEN
        found = [replace(one, severity="error") if one.code in wrong else one for one in self._state.findings]
        axes = self._state.model.axes if self._state.model else {}
        spoilt = {axis: one.code for one in found for axis in spoiled([one], axes)}
        spoilt |= dict.fromkeys(frozen_axes(found), FROZEN)
        return {axis: f"its numbers are not the vehicle's ({code})" for axis, code in spoilt.items()}

    @property
    def summary(self) -> str:
        """One line about the gains published so far; without any, or where the vehicle then changed, why not others."""
        if self.published:
            each = "; ".join(f"{', '.join(axes)} at {time:.0f} s" for time, axes in self.published)
            return f"New gains: {each}.{f' They are in {self._path}.' if self._path else ''}{self._outdated}"
        why: dict[str, list[str]] = {}
        for axis in self._state.axes:
            why.setdefault(self._missing(axis), []).append(axis)
        each = "; ".join(f"{', '.join(axes)}: {reason}" for reason, axes in why.items())
        return f"No new gains. {each or 'Nothing was tracked'}."

    @property
    def _outdated(self) -> str:
        """For each axis that changed after its last new gains, why they were not replaced."""
        return "".join(
            f" Those of {axis} are of before the alarm of {alarm.raised:.1f} s ({alarm.named}): {self._missing(axis)}."
            for axis, (alarm, named) in self._changed.items()
            if self._last.get(axis, math.inf) < named
        )

    def _missing(self, axis: str) -> str:
        """Why an axis has no new gains."""
        if axis in (misread := self._misread):
            return misread[axis]
        if axis in self._retuning.kept:
            return self._retuning.kept[axis]
        state = self._state.axes.get(axis, TrackedAxis())
        if UNMOVED in state.state:
            return "not commanded in this flight"
        if state.knowledge == "not_excited":
            return "not excited in this flight: its commands do not explain its motion"
        if state.knowledge == "known":
            return "its estimate has not settled: two fits in a row do not agree yet"
        return "not known well enough in this flight"

    def _axes(self) -> list[tuple[str, dict[str, Any]]]:
        return [(axis, self._gains["axes"][axis]) for axis in AXES if axis in self._gains["axes"]]

    def _publish(self, found: Retuned, model: Model, time: float, now: int) -> None:
        mapping = tuning_mapping(found.tuning, model)
        when = {"retuned_at": time, "regime": self._state.regime}
        new = {axis: {**one, **when} for axis, one in mapping["axes"].items()}
        axes = {**dict(self._axes()), **new}
        axes = {axis: axes[axis] for axis in AXES if axis in axes}
        missing = {axis: self._missing(axis) for axis in AXES if axis not in axes}
        self._gains = {**mapping, "axes": axes, "refused": missing}
        if self._path:
            self._kept(write_gains(self._gains, self._path, keep=not self._replaced))
            self._replaced = True
        self.published.append((time, tuple(new)))
        file = str(self._path) if self._path else None
        loop = {name: mapping[name] for name in ("design", "rate", "latency", "note")}
        message = {"type": "gains", "time": time, "axes": new, "why": dict(found.why), **loop, "file": file}
        for listener in self.listeners:
            listener(message, now)
