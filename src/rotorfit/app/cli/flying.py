"""Verbs before and during a flight."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorfit.app.cli.options import (
    AFTER,
    JSON,
    SEED,
    TUNE,
    Number,
    card_option,
    compiled_beforehand,
    file_at,
    print_json,
    progress_bar,
    say_kept,
    silence,
    some_axes_of,
)
from rotorfit.flying.links import LINKS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rotorfit.app.terminal.tables import View
    from rotorfit.flying.beside import Beside


@click.command()
@card_option("that of --after", "Built-in card, TOML file or sim:VEHICLE, with the limits")
@click.option("--after", type=file_at(dir_okay=False), metavar="model.json", help="Design the next flight for a model.")
@click.option(
    "--design",
    type=click.Choice(["two_sines", "multisine", "chirp", "doublets", "3211", "prbs", "ident", "optimal", "optimal_a"]),
    help="Signal design; default: multisine, or with --after the most informative one.",
)
@click.option(
    "--room", metavar="6x4x3", help="Size of the room [m], origin at the centre of its floor; default: 6x4x3."
)
@click.option("--box", metavar="x0,y0,z0,x1,y1,z1", help="The fence, instead of a room, in the frame of the poses [m].")
@click.option(
    "--axes",
    metavar="x,y,z,yaw",
    callback=some_axes_of,
    help="Axes to excite; default: all, or with --after the least known.",
)
@click.option("--separate", is_flag=True, help="Separate flights, as in the paper: x with y, z, yaw.")
@click.option("--open-loop", is_flag=True, help="No feedback on any axis.")
@click.option(
    "--duration",
    type=Number(0, 1800, 60),
    default=60.0,
    metavar="S",
    help="Longest duration of a flight [s]; default: 60.",
)
@click.option(
    "--amplitude", type=float, metavar="A", help="Factor on the full amplitude; default: the largest that fits."
)
@click.option(
    "--speed", type=float, metavar="V", help="Largest horizontal speed; below 1, of the climb too [m/s]; default: 1.5."
)
@click.option("--seed", type=SEED, default=0, metavar="N", help="Random seed; default: 0.")
@click.option(
    "-o", "output", type=file_at(), metavar="plan.toml", help="Write the plan; an edited one is not overwritten."
)
@click.option("--picture", type=file_at(), metavar="plan.png", help="Plot commands, path, speeds and standard errors.")
@JSON
def plan(output: Path | None, picture: Path | None, as_json: bool, **asked: Any) -> None:
    """Design a flight, and predict its path and the accuracy of a fit to it."""
    from rotorfit.files.plans import check_plan_destination, save_plan
    from rotorfit.planning.preview import PICTURE_MARK, check_picture_name, write_picture
    from rotorfit.planning.request import Request, destinations, planned, plans_mapping

    request = Request(**asked)
    files, pictures = (destinations(path, request) if path else [] for path in (output, picture))
    for path in files:
        check_plan_destination(path)
    if pictures:
        from rotorfit.app.workflows import check_destination  # it brings the assessment

        for path in pictures:
            check_destination(path, PICTURE_MARK)
            check_picture_name(path)
    with progress_bar() as progress:
        plans, proposal = planned(request, progress)
    for one, path in zip(plans, files, strict=False):
        say_kept(save_plan(one, path))
    for one, path in zip(plans, pictures, strict=False):
        write_picture(one, path)
    if as_json:
        return print_json(plans_mapping(plans, files, pictures, proposal))
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.outlook import next_view, plan_view

    if proposal:
        show(next_view(proposal))
    for number, one in enumerate(plans):
        show([*([""] if number else []), *plan_view(one)])
    for path in (*files, *pictures):
        click.echo(f"\nWritten to {path}.")
    if not files:
        click.echo("\nNothing was written; -o plan.toml keeps the plan.")
    return None


@click.command()
@click.argument("plan_path", metavar="PLAN")
@click.option(
    "--link",
    "link",
    metavar="NAME[:ADDRESS]",
    required=True,
    help=f"{', '.join(kind.usage for kind in LINKS.values())}.",
)
@click.option("--poses", metavar="NAME:ADDRESS", default="", help="Take the poses from another link: ros1:/TOPIC.")
@click.option("-o", "output", type=file_at(), metavar="flight.mcap", required=True, help="The recording to write.")
@card_option("the plan's own")
@click.option("--land/--no-land", default=True, help="Land (default) or hover at the end, whatever ended the flight.")
@click.option("--take-off", is_flag=True, help="Begin on the floor.")
@click.option("--seed", type=SEED, default=0, metavar="N", help="Random seed of a simulated vehicle; default: 0.")
@click.option("--track", is_flag=True, help="Track the model meanwhile, in a separate process; alarms are recorded.")
@AFTER
@TUNE
@click.option("--yes", is_flag=True, help="Do not ask before a real vehicle moves.")
@JSON
def fly(
    plan_path: str, link: str, poses: str, output: Path, card: str | None, land: bool, take_off: bool, seed: int,
    track: bool, after: Path | None, gains: str | None, yes: bool, as_json: bool,
) -> None:  # fmt: skip
    """Fly a plan under guard and record it; Ctrl-C or the space bar ends it in hover."""
    from rotorfit.app.live.beside import asked_of, tracked_beside
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.cockpit import ended_early, flown_view, next_command, preflight_view, status_line
    from rotorfit.core.errors import LinkError
    from rotorfit.files.plans import load_plan
    from rotorfit.flying.links.sim import changes_missed
    from rotorfit.flying.mission import check_new, flown_mapping, flown_mission, mission
    from rotorfit.flying.preflight import refuse

    if not track and (after or gains is not None):
        raise click.UsageError("--after and --tune are for --track")
    if track:
        check_new(output)
        _check_tracking(load_plan(plan_path).card, after, gains)
        compiled_beforehand()
    with mission(plan_path, link, output, card, take_off, seed, poses) as wanted:
        if not as_json:
            _shown_first(preflight_view(wanted.plan, link, wanted.ready, wanted.link.fail_safe))
        refuse(wanted.ready)
        if wanted.link.live and not yes:
            click.confirm("A real vehicle will move. Fly?", abort=True, err=True)
        asked = asked_of(wanted.plan.card, after, gains, not wanted.link.live, str(output)) if track else None
        with tracked_beside(asked) as beside:
            result = flown_mission(wanted, land, lambda: status_line(lambda: _tracked(beside)), beside)
            if beside:
                click.echo("tracker: fitting the flight once more (Ctrl-C leaves it out)", err=True)
        if beside:
            _show_last(beside)
        if missed := changes_missed(link, wanted.link.now):
            click.echo(f"{link}: {missed}", err=True)
    completed = result.reason == "completed"
    try:
        if as_json:
            print_json(flown_mapping(result, wanted.ready, wanted.link.live))
        elif completed:
            show(flown_view(result, wanted.link.live))
            click.echo(f"\nNext: {next_command([str(output)])}")
        told = completed
    except BrokenPipeError:
        silence()
        told = False
    if not told:  # a vehicle that does not land must not go unnoticed
        for note in result.notes:
            click.echo(note, err=True)
    if not completed:
        raise LinkError(ended_early(result))
    if not told:
        click.echo(f"Nobody reads the output any more. Flown: {result.text}; the log: {output}", err=True)


def _check_tracking(card: "Mapping[str, Any]", after: Path | None, gains: str | None) -> None:
    """Refuses files that the tracker beside the flight could not use, before anything moves.

    Raises:
        ModelError: The model or the gains cannot be read.
        CardError: The commands of the model have another meaning.
        LogError: The path of the gains is taken by something else.
    """
    from rotorfit.app.live.regained import regaining_of
    from rotorfit.files.cards import card_from_mapping
    from rotorfit.tracking.earlier import check_earlier, earlier_of, limits_of_earlier

    earlier = earlier_of(after) if after else None
    if earlier:
        flown = card_from_mapping(card, "the plan's card")
        check_earlier(earlier, flown)
        for told in limits_of_earlier(earlier, flown):
            click.echo(told, err=True)
    if gains is not None:
        regaining_of(gains, lambda _message, _now: None, say_kept, earlier)


def _tracked(beside: "Beside | None") -> str:
    """The text of the tracker beside a flight, shown before the status."""
    if beside is None:
        return ""
    alarm = f"{beside.alarm} | " if beside.alarm else ""
    return f"{alarm}{beside.words or 'tracker begins'} | "


def _show_last(beside: "Beside") -> None:
    """Shows all alarms and gains of the tracker beside a flight, and its end."""
    for text in beside.told:
        click.echo(text, err=True)
    if beside.lost:
        click.echo(f"tracker: {beside.lost} samples came too fast and were left out", err=True)
    until = f"it had come to {beside.time:.1f} s: {beside.words}" if beside.words else "it had told nothing yet"
    click.echo(beside.summary or f"tracker: ended before its last fit; {until}", err=True)


def _shown_first(view: "View") -> None:
    """Shows what the user must see before a vehicle moves.

    Raises:
        LinkError: The output is closed.
    """
    from rotorfit.app.terminal import show
    from rotorfit.core.errors import LinkError

    try:
        show(view)
    except BrokenPipeError:
        silence()
        raise LinkError(
            "not flown: nobody reads the output (a closed pipe), so nobody has seen the preflight; "
            "let it be read to its end, or write it to a file"
        ) from None
