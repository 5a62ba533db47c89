"""Model: coefficients with their uncertainty, disturbance levels, and where they come from. Simulate, save, load."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit import __version__
from rotorfit.accuracy import PriorUse, Uncertainty, uncertainty_from_mapping
from rotorfit.card import Card, card_from_mapping
from rotorfit.errors import ModelError
from rotorfit.finding import Finding
from rotorfit.flight import Note
from rotorfit.frames import AXES, Array
from rotorfit.settings import Conversion, Figure, Quantity

FORMAT = "rotorfit-model"
VERSION = 1
COEFFICIENTS = ("input", "damping", "delay")
STRUCTURE = "first_order_delay"

Interval = tuple[float | None, float | None]


@dataclass(frozen=True)
class Combination:
    """A combination of coefficients that can be known when its parts cannot.

    Attributes:
        value: The estimate.
        ci95: Its 95 % interval; an open end is None.
    """

    value: float
    ci95: Interval


@dataclass(frozen=True)
class Predictor:
    """The likelihood's own point of an axis: what simulation and prediction use.

    Attributes:
        input: g.
        damping: b [1/s].
        delay: tau [s].
    """

    input: float
    damping: float
    delay: float


@dataclass(frozen=True)
class Mode:
    """An optimum of the likelihood that the search found.

    Attributes:
        delay: [s].
        damping: [1/s].
        input: g.
        log_likelihood: Less that of the best optimum.
        starts: How many starts ended here.
        prediction: RMSE of 1 s velocity predictions on the training flights [unit/s]; None where it was not needed.
        chosen: Whether the model is this one.
    """

    delay: float
    damping: float
    input: float
    log_likelihood: float
    starts: int
    prediction: float | None
    chosen: bool


@dataclass(frozen=True)
class Axis:
    """What is known of one axis: a = input u(t - delay) - damping v.

    Attributes:
        input: g, in m/s^2 (yaw: rad/s^2) per unit of the command; None where the data cannot tell.
        damping: b [1/s].
        delay: tau [s].
        stderr: Coefficient name to standard error.
        ci95: Coefficient name to 95 % interval; an open end is None.
        status: Coefficient name to `ok`, `not_excited`, `not_identifiable`, `diverged` or `too_short`.
        trim: Constant acceleration in the heading frame, one per flight; None where a flight did not serve this axis.
        noise: `wind_power`, `pose_variance`, `wind_damping`, `wind_overlap` and `trim_variance` of the disturbance.
        predictor: What simulation uses; None where the axis is not excited.
        combinations: `steady_gain` (g / b) and `total_lag` (delay + 1 / b) [s].
        modes: Optima of the likelihood, the chosen one first.
        profile: Delays [s] and the log-likelihood, less its maximum, re-maximised over everything else at each.
        profile_fall: How far it falls to the ends of the delay's interval.
    """

    input: float | None
    damping: float | None
    delay: float | None
    stderr: Mapping[str, float | None]
    ci95: Mapping[str, Interval]
    status: Mapping[str, str]
    trim: tuple[float | None, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    predictor: Predictor | None = None
    combinations: Mapping[str, Combination] = field(default_factory=dict)
    modes: tuple[Mode, ...] = ()
    profile: tuple[tuple[float, float], ...] = ()
    profile_fall: float | None = None


def unknown_axis(status: str) -> Axis:
    """An axis of which nothing is known, and why."""
    nothing = dict.fromkeys(COEFFICIENTS)
    return Axis(
        input=None,
        damping=None,
        delay=None,
        stderr=nothing,
        ci95=dict.fromkeys(COEFFICIENTS, (None, None)),
        status=dict.fromkeys(COEFFICIENTS, status),
    )


@dataclass(frozen=True)
class Source:
    """A flight that the model was fitted to.

    Attributes:
        path: As given.
        sha256: Of the log.
        span: Seconds of its common window.
        notes: Repairs.
        axes: The axes that it served.
    """

    path: str
    sha256: str
    span: tuple[float, float]
    notes: tuple[Note, ...] = ()
    axes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Model:
    """A fitted model.

    Attributes:
        card: The card that was applied.
        structure: Name of the model structure.
        method: `ml`, `robust`, `paper`, `svf`, `weak`, `iv` or `oe`.
        axes: Axis name to what is known of it, for all four axes.
        covariance_names: Rows of the covariance, such as `x.input`, over (input, damping, delay) of the excited axes.
        covariance: Shape (P, P).
        paper: gamma of the paper's method on the same data, shape (8,), None where it gives no number.
        findings: What the user should know.
        flights: What it was fitted to.
        rotorfit: Version that wrote it.
        uncertainty: The accuracy table; None where it was not asked for.
        prior: Coefficient, such as `x.input`, to what the card's prior did to it; None where no prior was used.
        physics: Axis name to physical quantities, as `physics.physics` gives them; for the reader of the file.
        conversion: Set where the model was converted to other limits than those of its flights.
        leave_one_out: Proof by leaving out each flight in turn, in the plain types of the file; None where it was not
            asked for. See `leave_one_out.LeaveOneOut`.
    """

    card: Card
    structure: str
    method: str
    axes: Mapping[str, Axis]
    covariance_names: tuple[str, ...]
    covariance: Array
    paper: tuple[float | None, ...]
    findings: tuple[Finding, ...]
    flights: tuple[Source, ...]
    rotorfit: str = __version__
    uncertainty: Uncertainty | None = None
    prior: Mapping[str, PriorUse] | None = None
    physics: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    conversion: Conversion | None = None
    leave_one_out: Mapping[str, Any] | None = None

    @property
    def gamma(self) -> tuple[float | None, ...]:
        """The paper's eight coefficients, g and b of x, y, z, yaw in turn; None where the data cannot tell."""
        return tuple(value for axis in AXES for value in (self.axes[axis].input, self.axes[axis].damping))


def with_findings(model: Model, findings: Sequence[Finding]) -> Model:
    """The model with these findings."""
    return replace(model, findings=tuple(findings))


@dataclass(frozen=True)
class StateSpace:
    """Linear model of the excited axes in a frame that keeps the heading: x' = A x + B u(t - delay), y = C x.

    Attributes:
        axes: The n axes; the states are their positions, then their velocities.
        A: Shape (2 n, 2 n).
        B: Shape (2 n, n).
        C: Positions, shape (n, 2 n).
        delay: One per input, shape (n,) [s].
    """

    axes: tuple[str, ...]
    A: Array
    B: Array
    C: Array
    delay: Array


def state_space(model: Model) -> StateSpace:
    """Linear state space of the excited axes in the heading frame.

    Raises:
        ModelError: If no axis has a predictor.

    Source: paper, eq. (4), with an input delay.
    """
    axes = tuple(axis for axis in AXES if model.axes[axis].predictor)
    if not axes:
        raise ModelError("the model has no excited axis: nothing to build a state space from; fit a flight that moves")
    points = [predictor_of(model, axis) for axis in axes]
    n = len(axes)
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, n:] = -np.diag([point.damping for point in points])
    B = np.vstack([np.zeros((n, n)), np.diag([point.input for point in points])])
    return StateSpace(axes, A, B, np.hstack([np.eye(n), np.zeros((n, n))]), np.array([p.delay for p in points]))


def predictor_of(model: Model, axis: str) -> Predictor:
    """The predictor of an axis.

    Raises:
        ModelError: If the axis was not excited.
    """
    predictor = model.axes[axis].predictor
    if predictor is None:
        raise ModelError(
            f"the model has no numbers for {axis} ({model.axes[axis].status['input']}): fit a flight that moves it"
        )
    return predictor


@dataclass(frozen=True)
class Trajectory:
    """A simulated motion: times (N,), pose x, y, z, yaw (N, 4) and its rate (N, 4), world frame, SI."""

    time: Array
    pose: Array
    velocity: Array


def simulate(
    model: Model,
    command_time: Array,
    command: Array,
    time: Array,
    pose: Array | None = None,
    velocity: Array | None = None,
) -> Trajectory:
    """Motion under held commands from a given state; axes without a predictor keep their velocity.

    Args:
        model: The model.
        command_time: Increasing stamps, shape (M,) [s]. A command holds until the next; before the first, the first.
        command: x, y, z, yaw commands in the heading frame, shape (M, 4).
        time: Increasing times at which the motion is wanted, shape (N,) [s]; the motion starts at the first.
        pose: World x, y, z, yaw at the first time, shape (4,); the origin by default.
        velocity: Its rate, shape (4,); rest by default.

    Returns:
        The trajectory, without trim and disturbance.

    Source: paper, eq. (5), with u(t - delay).
    """
    from rotorfit.prediction import coast

    pose = np.zeros(4) if pose is None else np.asarray(pose, float)
    velocity = np.zeros(4) if velocity is None else np.asarray(velocity, float)
    time, command_time, command = (np.asarray(a, float) for a in (time, command_time, command))
    points = [model.axes[axis].predictor or Predictor(0.0, 0.0, 0.0) for axis in AXES]
    gain, damping, delay = (np.array([getattr(p, name) for p in points]) for name in COEFFICIENTS)

    def run(pair: list[int], heading: Array) -> Array:
        return coast(
            command_time, np.ascontiguousarray(command[:, pair]), gain[pair], damping[pair], delay[pair],
            pose[pair], velocity[pair], time, heading,
        )  # fmt: skip

    side = run([2, 3], np.zeros(time.size))
    plane = run([0, 1], np.ascontiguousarray(side[:, 1]))
    return Trajectory(time, np.hstack([plane[:, :2], side[:, :2]]), np.hstack([plane[:, 2:], side[:, 2:]]))


def save(model: Model, path: str | Path) -> None:
    """Writes a model file (JSON, without NaN)."""
    Path(path).write_text(json.dumps(to_mapping(model), indent=1, allow_nan=False) + "\n")


def load(path: str | Path) -> Model:
    """Reads a model file.

    Raises:
        ModelError: If it is missing, no model file, or of a newer version.
    """
    try:
        raw = json.loads(Path(path).read_text())
    except OSError as error:
        raise ModelError(
            f"{path}: cannot be read ({error.strerror}); give a model file written by `rotorfit fit -o`"
        ) from None
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ModelError(f"{path}: not a model file ({error}); give one written by `rotorfit fit -o`") from None
    return from_mapping(raw, str(path))


def is_model_file(path: str | Path) -> bool:
    """Whether a file is a model, by content."""
    with Path(path).open("rb") as file:
        return file.read(4096).lstrip()[:1] == b"{" and FORMAT.encode() in Path(path).read_bytes()[:4096]


def to_mapping(model: Model) -> dict[str, Any]:
    """The model as plain JSON types."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "rotorfit": model.rotorfit,
        "card": dict(model.card.raw),
        "structure": model.structure,
        "method": model.method,
        "gamma": list(model.gamma),
        "axes": {name: asdict(axis) for name, axis in model.axes.items()},
        "covariance": {"names": list(model.covariance_names), "matrix": model.covariance.tolist()},
        "paper": {"gamma": list(model.paper)},
        "physics": {name: {key: asdict(part) for key, part in parts.items()} for name, parts in model.physics.items()},
        "conversion": asdict(model.conversion) if model.conversion else None,
        "findings": [asdict(finding) for finding in model.findings],
        "flights": [asdict(flight) for flight in model.flights],
        "uncertainty": model.uncertainty and asdict(model.uncertainty),
        "prior": None if model.prior is None else {name: asdict(use) for name, use in model.prior.items()},
        "leave_one_out": None if model.leave_one_out is None else dict(model.leave_one_out),
    }


def from_mapping(raw: Any, where: str) -> Model:
    """A model from the plain types of a model file.

    Raises:
        ModelError: If it is not one, or of a newer version.
    """
    if not isinstance(raw, dict) or raw.get("format") != FORMAT:
        raise ModelError(f"{where}: not a rotorfit model; give a file written by `rotorfit fit -o`")
    if raw.get("version") != VERSION:
        raise ModelError(
            f"{where}: model version {raw.get('version')}, this one reads {VERSION}; use the rotorfit that wrote it"
        )
    try:
        return Model(
            card=card_from_mapping(raw["card"], where),
            structure=raw["structure"],
            method=raw["method"],
            axes={name: _axis(raw["axes"][name]) for name in AXES},
            covariance_names=tuple(raw["covariance"]["names"]),
            covariance=np.array(raw["covariance"]["matrix"], float).reshape((len(raw["covariance"]["names"]),) * 2),
            paper=tuple(raw["paper"]["gamma"]),
            findings=tuple(Finding(**finding) for finding in raw["findings"]),
            flights=tuple(_source(flight) for flight in raw["flights"]),
            rotorfit=raw["rotorfit"],
            uncertainty=uncertainty_from_mapping(raw["uncertainty"]) if raw.get("uncertainty") else None,
            prior=None if raw.get("prior") is None else {name: PriorUse(**use) for name, use in raw["prior"].items()},
            physics={
                name: {key: _quantity(part) for key, part in parts.items()}
                for name, parts in raw.get("physics", {}).items()
            },
            conversion=Conversion(**raw["conversion"]) if raw.get("conversion") else None,
            leave_one_out=raw.get("leave_one_out"),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(f"{where}: damaged model file ({type(error).__name__}: {error}); fit it again") from None


def _axis(raw: Mapping[str, Any]) -> Axis:
    from rotorfit.disturbance import LEVELS  # on use: numba takes longer than naming a model may

    if raw["noise"] and set(raw["noise"]) != {*LEVELS, "trim_variance"}:
        raise KeyError(f"noise has {', '.join(sorted(raw['noise']))}")
    return Axis(
        **{
            **raw,
            "ci95": {name: tuple(ends) for name, ends in raw["ci95"].items()},
            "trim": tuple(raw["trim"]),
            "predictor": Predictor(**raw["predictor"]) if raw["predictor"] else None,
            "combinations": {
                name: Combination(part["value"], tuple(part["ci95"])) for name, part in raw["combinations"].items()
            },
            "modes": tuple(Mode(**mode) for mode in raw["modes"]),
            "profile": tuple((delay, value) for delay, value in raw["profile"]),
        }
    )


def _quantity(raw: Mapping[str, Any]) -> Quantity:
    figures = {name: raw[name] for name in ("measured", "ratio", "implied_limit")}
    known = {name: Figure(part["value"], tuple(part["ci95"])) if part else None for name, part in figures.items()}
    return Quantity(**{**raw, **known})


def _source(raw: Mapping[str, Any]) -> Source:
    return Source(
        path=raw["path"],
        sha256=raw["sha256"],
        span=tuple(raw["span"]),
        notes=tuple(Note(**note) for note in raw["notes"]),
        axes=tuple(raw["axes"]),
    )
