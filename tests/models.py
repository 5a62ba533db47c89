"""Models by hand, for tests of what is made of them."""

import itertools
import math
import tomllib
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from flights import CARD
from rotorfit.core.card import Card
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, Axis, Combination, Mode, Model, Predictor, Source, unknown_axis
from rotorfit.files.cards import card_from_mapping
from rotorfit.simulation.paper_vehicle import GAMMA_B

Point = tuple[float, float, float]

VEHICLE: Mapping[str, Point] = {
    axis: (GAMMA_B[2 * k], GAMMA_B[2 * k + 1], 0.1 + 0.05 * k) for k, axis in enumerate(AXES)
}
"""The demo's vehicle with a delay of its own on each axis: input, damping, delay."""


_FITS = itertools.count()


def axis_of(point: Point, error: float = 0.02) -> Axis:
    """An axis known to a relative error in gain and damping, and to 5 ms in the delay."""
    g, b, tau = point
    return Axis(
        input=g,
        damping=b,
        delay=tau,
        stderr={"input": error * abs(g), "damping": error * b, "delay": 0.005},
        ci95={
            "input": (g - 2 * error * abs(g), g + 2 * error * abs(g)),
            "damping": (b * math.exp(-2 * error), b * math.exp(2 * error)),
            "delay": (tau - 0.01, tau + 0.01),
        },
        status=dict.fromkeys(COEFFICIENTS, "ok"),
        trim=(0.01,),
        predictor=Predictor(g, b, tau),
        combinations={
            "steady_gain": Combination(g / b, (g / b * (1 - 2 * error), g / b * (1 + 2 * error))),
            "total_lag": Combination(tau + 1 / b, (tau + 0.9 / b, tau + 1.1 / b)),
        },
        modes=(Mode(tau, b, g, 0.0, 6, 0.02, True),),
        profile=((tau - 0.01, -1.9), (tau, 0.0), (tau + 0.01, -1.9)),
        profile_fall=1.9,
    )


def model_of(points: Mapping[str, Point] = VEHICLE, card: Card = CARD, error: float = 0.02) -> Model:
    """A model of these axes, nothing known of the others, with a full covariance."""
    known = [axis for axis in AXES if axis in points]
    names = tuple(f"{axis}.{name}" for axis in known for name in COEFFICIENTS)
    axes = {axis: axis_of(points[axis], error) if axis in points else unknown_axis("not_excited") for axis in AXES}
    deviation = np.array([axes[axis].stderr[name] or 0.0 for axis in known for name in COEFFICIENTS])
    covariance = np.outer(deviation, deviation) * (0.3 + 0.7 * np.eye(deviation.size))
    paper = tuple(value for axis in AXES for value in (points[axis][:2] if axis in points else (None, None)))
    return Model(card, "first_order_delay", "ml", axes, names, covariance, paper, (), ())


def next_fit(points: Mapping[str, Point] = VEHICLE, error: float = 0.02) -> Model:
    """As `model_of`, of a fit of its own: no two fits have the same errors to the last digit."""
    return model_of(points, error=error * (1 + 1e-12 * next(_FITS)))


def with_poses(model: Model, *flights: tuple[float, tuple[str, ...]]) -> Model:
    """The model with flights of so many fresh poses a second, and their axes."""
    sources = tuple(Source(f"{k}.csv", "0" * 64, (0.0, 30.0), (), axes, (), hz) for k, (hz, axes) in enumerate(flights))
    return replace(model, flights=sources)


def demo_card(limits: str | None = None, name: str | None = None, **channels: str) -> Card:
    """The demo's card with other limits (TOML; "" for none), another name, other channels (TOML inline tables)."""
    raw = dict(CARD.raw)
    if limits is not None:
        raw["limits"] = tomllib.loads(limits)
    if name is not None:
        raw["name"] = name
    raw["command"] = {**raw["command"], **{axis: tomllib.loads(f"c = {text}")["c"] for axis, text in channels.items()}}
    return card_from_mapping(raw, "test")


def without(model: Model, axis: str, *names: str) -> Model:
    """The model with these coefficients of an axis not identifiable, their upper ends open."""
    known = model.axes[axis]
    return replace(
        model,
        axes={
            **model.axes,
            axis: replace(
                known,
                **dict.fromkeys(names),  # type: ignore[arg-type]
                stderr={**known.stderr, **dict.fromkeys(names)},
                status={**known.status, **dict.fromkeys(names, "not_identifiable")},
                ci95={**known.ci95, **{name: (known.ci95[name][0], None) for name in names}},
            ),
        },
    )
