"""New gains while a vehicle flies: published as a message and, if wanted, as a file; nothing is ever commanded."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rotorfit.app.workflows import check_destination
from rotorfit.control.retuning import Flown, Retuned, Retuning
from rotorfit.control.tuning import LATENCY
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.core.tracked import UNMOVED, Tracked, TrackedAxis
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
    return Regaining(Path(path) if path else None, told, kept, earlier.model if earlier else None)


class Regaining:
    """Watches the states of a vehicle, and publishes new gains.

    The gains in the file at the start are taken as those in use, and its design, rate and latency are kept.

    Args:
        path: Path of the gains file, TOML or YAML; None for messages alone.
        listener: The first of the listeners.
        kept: Called with the path of the backup when the original file is first replaced.
        before: The model of an earlier flight; None if there is none.

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
        before: Model | None = None,
    ) -> None:
        self._path, self.listeners, self._kept = path, [listener], kept
        self.published: list[tuple[float, Sequence[str]]] = []
        self._states: Mapping[str, TrackedAxis] = {}
        self._gains: dict[str, Any] = {"design": "predictor", "rate": None, "latency": LATENCY, "axes": {}}
        if path:
            check_gains_name(path)
            check_destination(path, GAINS_MARK)
            self._gains = read_gains(path) if path.exists() else self._gains
        flown = {axis: Flown(law_of(self._gains, axis), float(one["bandwidth"])) for axis, one in self._axes()}
        loop = self._gains["design"], self._gains["rate"], self._gains["latency"]
        self._retuning = Retuning(*loop, flown, before)

    def state(self, state: Tracked, now: int) -> None:
        """Publishes new gains if a state calls for them."""
        for alarm in state.alarms:
            if alarm.cause in OF_THE_VEHICLE:
                self._retuning.changed(alarm.axes, alarm.cause, alarm.revises is not None)
        self._states = state.axes
        if state.model is None or state.landed:
            return
        axes = {
            word: [axis for axis, one in state.axes.items() if one.knowledge == word]
            for word in ("known", "not_identifiable")
        }
        if found := self._retuning.look(state.model, axes["known"], axes["not_identifiable"]):
            self._publish(found, state.model, state.time, now)

    @property
    def summary(self) -> str:
        """One line about the gains published so far; without any, why there are none."""
        if self.published:
            each = "; ".join(f"{', '.join(axes)} at {time:.0f} s" for time, axes in self.published)
            return f"New gains: {each}.{f' They are in {self._path}.' if self._path else ''}"
        why: dict[str, list[str]] = {}
        for axis in self._states:
            why.setdefault(self._missing(axis), []).append(axis)
        each = "; ".join(f"{', '.join(axes)}: {reason}" for reason, axes in why.items())
        return f"No new gains. {each or 'Nothing was tracked'}."

    def _missing(self, axis: str) -> str:
        """Why an axis has no new gains."""
        if axis in self._retuning.kept:
            return self._retuning.kept[axis]
        state = self._states.get(axis, TrackedAxis())
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
        new = {axis: {**one, "retuned_at": time} for axis, one in mapping["axes"].items()}
        axes = {**dict(self._axes()), **new}
        axes = {axis: axes[axis] for axis in AXES if axis in axes}
        missing = {axis: self._missing(axis) for axis in AXES if axis not in axes}
        self._gains = {**mapping, "axes": axes, "refused": missing}
        if self._path:
            self._kept(write_gains(self._gains, self._path, keep=not self.published))
        self.published.append((time, tuple(new)))
        file = str(self._path) if self._path else None
        loop = {name: mapping[name] for name in ("design", "rate", "latency", "note")}
        message = {"type": "gains", "time": time, "axes": new, "why": dict(found.why), **loop, "file": file}
        for listener in self.listeners:
            listener(message, now)
