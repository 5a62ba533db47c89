"""Verbs that hand a model over to a controller, an estimator or a simulator."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorfit.app.cli.options import JSON, MODEL, SEED, axes_of, file_at, print_json, progress_bar, say_kept

if TYPE_CHECKING:
    from rotorfit.core.model import Model
    from rotorfit.core.results import Validation


@click.command()
@click.argument("model_path", metavar="[MODEL]", required=False)
@click.argument("logs", metavar="[LOG...]", nargs=-1)
@click.option("--to", "to", metavar="NAME", help="The format; without it, the formats are listed.")
@click.option(
    "-o", "output", type=file_at(), metavar="FILE", help="File to write; its name becomes that of the vehicle."
)
@click.option(
    "--dt", type=float, metavar="S", help="Sample period for --to c, --round-delay, 1e-4 to 10; default: 0.02."
)
@click.option("--predictor", is_flag=True, help="Also axes that are not identifiable, at the point that predicts best.")
@click.option("--physical", is_flag=True, help="Commands in rad, m/s and rad/s instead of fractions of limits.")
@click.option("--round-delay", is_flag=True, help="Round delays to whole samples of --dt; the file states by how much.")
@JSON
def export(
    model_path: str | None,
    logs: Sequence[str],
    to: str | None,
    output: Path | None,
    dt: float | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Write a model for a controller, an estimator or a simulator.

    With LOGs the file also states the errors of predictions on them. Without --to, lists the formats.
    """

    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.handover import export_formats_view, export_mapping, export_view
    from rotorfit.exports import MARK
    from rotorfit.exports import export as write
    from rotorfit.exports.formats import FORMATS

    if to is None:
        if output or logs:
            raise click.UsageError("--to FORMAT is missing: which format is to be written?")
        if as_json:
            told = ("suffix", "text", "linear", "plain", "needs")
            return print_json(
                {"formats": {name: {key: getattr(form, key) for key in told} for name, form in FORMATS.items()}}
            )
        return show(export_formats_view(FORMATS))
    if model_path is None or output is None:
        raise click.UsageError("give a model and -o FILE: rotorfit export model.json --to NAME -o FILE")
    if dt is not None and to in FORMATS and not (FORMATS[to].sampled or asked["round_delay"]):
        raise click.UsageError(f"--dt is for --to c and --round-delay: a file of {to} is for any sample period")
    from rotorfit.app.workflows import check_destination, training_flights, validate_logs
    from rotorfit.exports.validity import trained_on
    from rotorfit.files.log_span import parse_log
    from rotorfit.files.models import load

    check_destination(output, MARK)
    model = load(model_path)
    trained = trained_on(training_flights(model)[0])
    if dt is not None:
        asked["dt"] = dt

    def score(exported: "Model") -> "Validation":
        """On the logs."""
        with progress_bar() as progress:
            return validate_logs(exported, [parse_log(log) for log in logs], progress=progress)[0]

    made = write(model_path, to, output, trained=trained, score=score if logs else None, **asked)
    say_kept(made.kept)
    if as_json:
        return print_json(export_mapping(made, str(output)))
    return show(export_view(made, str(output)))


@click.command()
@MODEL
@click.option(
    "--design",
    type=click.Choice(["predictor", "lqr", "linearising"]),
    default="predictor",
    help="The law: state predictor (default), LQR with the delay, or feedback linearisation.",
)
@click.option(
    "--rate",
    type=float,
    metavar="HZ",
    help="Command rate, each command from a fresh pose; default: 50 Hz, or that of the model's poses if lower.",
)
@click.option(
    "--latency", type=float, default=0.015, metavar="S", help="Age of a pose when it is used; default: 0.015 s."
)
@click.option("--axes", metavar="x,y,z,yaw", callback=axes_of, help="The axes to tune; default: all.")
@click.option(
    "--peak", type=float, default=1.7, metavar="RATIO", help="Largest peak of the sensitivity, 1.2 to 3; default: 1.7."
)
@click.option(
    "--seed",
    type=SEED,
    default=0,
    metavar="N",
    help="Random seed of the vehicles drawn from the covariance; default: 0.",
)
@click.option(
    "--try", "address", metavar="VEHICLE", help="Test the gains in the flight room: bebop2,wind=1.5,gusts=0.3."
)
@click.option(
    "-o", "output", type=file_at(dir_okay=False), metavar="gains.toml", help="Write the gains (.toml, .yaml)."
)
@JSON
def tune(
    model_path: str,
    design: Any,
    rate: float | None,
    latency: float,
    axes: Any,
    peak: float,
    seed: int,
    address: str | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Tune a position controller, as fast as the accuracy of the model allows."""
    from rotorfit.app.workflows import check_destination
    from rotorfit.control.tuning import tune as tuned
    from rotorfit.core.errors import RotorfitError
    from rotorfit.exports.gains import GAINS_MARK, check_gains_name, save_gains, tuning_mapping
    from rotorfit.files.models import load

    if output:
        check_gains_name(output)
        check_destination(output, GAINS_MARK)
    model = load(model_path)
    if address:
        from rotorfit.control.trial import trial_vehicle

        trial_vehicle(model, address, axes)
    tuning = tuned(model, design, rate=rate, latency=latency, axes=axes, peak=peak, seed=seed)
    if output:
        say_kept(save_gains(tuning, model, output))
    told = tuning_mapping(tuning, model)
    if not as_json:
        from rotorfit.app.terminal import show
        from rotorfit.app.terminal.handover import trial_view, tuning_view

        show(tuning_view(tuning, model.card))
        click.echo(
            f"\nGains written to {output}." if output else "\nNothing was written; -o gains.toml keeps the gains."
        )
    if address:
        from rotorfit.control.trial import scores_mapping, try_tuning

        try:
            scores = try_tuning(tuning, model, address)
        except RotorfitError:
            if as_json:
                print_json(told)
            raise
        if not as_json:
            click.echo()
            return show(trial_view(scores, address))
        told["trial"] = scores_mapping(scores)
    return print_json(told) if as_json else None
