"""Convert: the same vehicle under other tilt, climb and rotation limits.

Gains are per command. Where a command is a fraction of a limit, another limit changes the gain of the same vehicle;
damping, delay, disturbance and trim belong to the vehicle and the air, and stay.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from rotorfit.core.accuracy import PriorUse
from rotorfit.core.card import Card
from rotorfit.core.errors import ModelError
from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES, Array
from rotorfit.core.limits import Conversion, Meaning, gain_factor, limit_text, meaning_of
from rotorfit.core.model import Evidence, Model, Spread, with_findings
from rotorfit.files.cards import card_from_mapping

PER_COMMAND: Mapping[str, int] = {
    "input": 1,
    "steady_gain": 1,
    "input_up": 1,
    "input_down": 1,
    "cross_input": 1,
    "level": -1,
    "dead_zone": -1,
    "flights": 0,  # a count and a probability, of a quantity in commands
    "p_value": 0,
}
"""Name of a parameter or combination to the power of the factor that it is multiplied by: 1 for quantities per command,
-1 for quantities in commands. A number under another name inherits the power of what contains it, 0 at the top level.

A new parameter in the unit of the command needs a row here: coefficients, errors, intervals, combinations, optima,
predictor and covariance are all scaled by this table. `cross_input` is per command of the other horizontal axis, which
has the same limit: see `check_cross_inputs`.
"""


def convert(model: Model, limits: Mapping[str, Any]) -> Model:
    """The same vehicle under other limits.

    Gains of axes whose commands are fractions of a changed limit are multiplied by tan(t') / tan(t) for the tilt, and
    by the ratio for speeds and rates: input gains, steady gains, their errors and intervals, optima, the covariance,
    the paper's coefficients, and priors of the input in model and card. Everything else stays. Commands u of the old
    setting are u divided by that factor under the new one; then both models predict the same motion. The accuracy table
    and the leave-one-out are dropped.

    Args:
        model: Its card defines the meaning of the commands and the old limits.
        limits: The new settings in the form of a card's `[limits]`, as from `core.limits.limits_from_text`; limits that
            are not named stay.

    Returns:
        The model with the new limits in its card and the old ones in `conversion`; converted back to its first
        limits it is the first model again.

    Raises:
        CardError: An invalid limit, unit or size.
        ModelError: No limit is named, the card has no value of one, no command of the card is a fraction of it, the
            limits are already those of the model, or its laws do not allow it, see `check_cross_inputs`.

    Source: at constant height a tilt t accelerates by 9.81 tan(t).
    """
    if not limits:
        raise ModelError("no limit is named: give one of the card's, such as tilt, with its new value")
    card = _card_under(model, limits)
    factors = dict.fromkeys(AXES, 1.0)
    for limit in limits:
        for axis in _axes_of(model, limit):
            factors[axis] = gain_factor(limit, model.card.limits[limit], card.limits[limit])
    if card.limits == model.card.limits:
        raise ModelError(f"the model already has this {' and '.join(limits)}: nothing to convert")
    check_cross_inputs(model, factors)
    converted = replace(
        model,
        card=_with_prior(card, factors),
        axes={name: scaled(axis, factors[name]) for name, axis in model.axes.items()},
        covariance=_covariance(model, factors),
        paper=tuple(
            None if value is None else value * (factors[AXES[k // 2]] if k % 2 == 0 else 1.0)
            for k, value in enumerate(model.paper)
        ),
        conversion=_conversion(model, card, factors),
        prior=model.prior and {name: _prior_use(name, use, factors) for name, use in model.prior.items()},
        uncertainty=None,  # these two belong to the flights as flown
        leave_one_out=None,
    )
    return with_findings(converted, _findings(converted))


def check_cross_inputs(model: Model, factors: Mapping[str, float]) -> None:
    """Refuses factors on the gains that differ between x and y, where one also answers to the command of the other.

    Raises:
        ModelError: They do.
    """
    for axis, other in (("x", "y"), ("y", "x")):
        point = model.axes[axis].predictor
        if point and "cross_input" in point.extra and factors[axis] != factors[other]:
            raise ModelError(
                f"{axis} also answers to the command of {other}, which would change by another factor: fit another "
                "law, such as --structure averaged"
            )


def _card_under(model: Model, limits: Mapping[str, Any]) -> Card:
    """The model's card with these limits; the original card if they equal those of the fit."""
    raw = {**model.card.raw, "limits": {**model.card.raw.get("limits", {}), **limits}}
    card = card_from_mapping(raw, "under the new limits")
    if model.conversion is None or card.limits != _flown_under(model, model.conversion).limits:
        return card
    return _flown_under(model, model.conversion)


def _with_prior(card: Card, factors: Mapping[str, float]) -> Card:
    """The card with the priors of gains scaled."""
    if not card.prior:
        return card
    prior = {axis: scaled(one, factors[axis]) for axis, one in card.raw["prior"].items()}
    return card_from_mapping({**card.raw, "prior": prior}, "under other limits")


def flown_card(model: Model) -> Card:
    """The card of the flights that a model was fitted to, under their limits."""
    if model.conversion is None:
        return model.card
    back = {axis: 1 / factor for axis, factor in model.conversion.factor.items()}
    return _with_prior(_flown_under(model, model.conversion), back)


def _prior_use(name: str, use: PriorUse, factors: Mapping[str, float]) -> PriorUse:
    """The effect of a prior on a coefficient, such as `x.input`; what is told in standard errors has no unit."""
    axis, part = name.split(".", 1)
    factor = factors[axis] ** PER_COMMAND.get(part, 0)
    return replace(use, mean=use.mean * factor, sd=use.sd * factor, data=use.data * factor)


def _flown_under(model: Model, conversion: Conversion) -> Card:
    """The card with the limits of the flights that the model was fitted to."""
    return card_from_mapping({**model.card.raw, "limits": conversion.limits}, "of the fit")


def _axes_of(model: Model, limit: str) -> list[str]:
    """The axes whose commands are fractions of a limit.

    Raises:
        ModelError: There is none, or the card does not give the limit.
    """
    meanings = {axis: meaning_of(model.card, axis) for axis in model.card.command}
    concerned = [axis for axis, meaning in meanings.items() if meaning.limit == limit]
    if not concerned:
        said = [meaning.reason or f"{axis} is {_fraction(meaning)}" for axis, meaning in meanings.items()]
        raise ModelError(
            f"no command of the model's card is a fraction of {limit}, so nothing converts: {'; '.join(said)}"
        )
    if limit not in model.card.limits:
        raise ModelError(
            f"the model's card does not say what {limit} was set in its flights: add it to [limits] of the card, "
            "fit again, then convert"
        )
    return concerned


def _fraction(meaning: Meaning) -> str:
    return f"a fraction of {meaning.limit}" if meaning.limit else f"{meaning.asked} in SI units"


def scaled(value: Any, factor: float, power: int = 0) -> Any:
    """Scales everything per command in a noun, mapping or tuple of numbers, according to `PER_COMMAND`.

    Args:
        value: The value; texts, None and bools are unchanged.
        factor: Factor on the gains.
        power: Power of the factor for numbers without a name of their own.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value * factor**power if power else value
    if isinstance(value, tuple):
        return tuple(scaled(part, factor, power) for part in value)
    if isinstance(value, Mapping):
        return {name: scaled(part, factor, PER_COMMAND.get(name, power)) for name, part in value.items()}
    if isinstance(value, Evidence):
        return value
    if isinstance(value, Spread) and value.logarithmic:  # spreads of logarithms have no unit
        shift = power * float(np.log(factor))
        each = tuple(one and (one[0] + shift, one[1]) for one in value.each)
        return replace(value, next_flight=scaled(value.next_flight, factor, power), each=each)
    if is_dataclass(value) and not isinstance(value, type):
        parts = {each.name: getattr(value, each.name) for each in fields(value)}
        return replace(value, **scaled(parts, factor, power))
    return value


def _covariance(model: Model, factors: Mapping[str, float]) -> Array:
    parts = (name.split(".", 1) for name in model.covariance_names)
    scale = np.array([factors[axis] ** PER_COMMAND.get(name, 0) for axis, name in parts])
    return model.covariance * np.outer(scale, scale)


def _conversion(model: Model, card: Card, factors: Mapping[str, float]) -> Conversion | None:
    """Conversion since the fit; None where the limits of the flights are restored."""
    before = model.conversion or Conversion(dict(model.card.raw["limits"]), dict.fromkeys(AXES, 1.0))
    if card.raw["limits"] == before.limits:
        return None
    return Conversion(before.limits, {axis: before.factor[axis] * factors[axis] for axis in AXES})


def _findings(model: Model) -> list[Finding]:
    """The findings of the fit, with a note that their figures belong to the old limits."""
    kept = [finding for finding in model.findings if finding.code != "converted"]
    if model.conversion is None:
        return kept
    old = _flown_under(model, model.conversion).limits
    changes = [
        f"{name} {limit_text(name, value)} to {limit_text(name, model.card.limits[name])}"
        for name, value in old.items()
        if model.card.limits[name] != value
    ]
    factors = [f"{axis} {factor:.4g}" for axis, factor in model.conversion.factor.items() if factor != 1]
    told = Finding(
        "converted",
        "info",
        f"the flights were flown under other limits: {', '.join(changes)}; gains times {', '.join(factors)}",
        "coefficients, intervals and covariance are those of the new limits; figures in other findings are of the old",
        "validate on a flight under the new limits before you rely on large commands",
    )
    return [*kept, told]
