"""What the terminal shows of what is known: cards and formats."""

from collections.abc import Iterable, Mapping

from rich.text import Text

from rotorfit.card import Card, Channel
from rotorfit.card_columns import split_source
from rotorfit.terminal.tables import View, indented, table, title

FORMATS = {
    "rosbag1": "ROS 1 bag (.bag)",
    "rosbag2": "ROS 2 bag: its folder, or a lone .db3",
    "mcap": "MCAP with ROS messages (.mcap), encodings cdr and ros1",
    "mat": "MATLAB, version 5 to 7.2 (.mat), also from Octave and scipy",
    "mat73": "MATLAB, version 7.3 (.mat); needs h5py: pip install 'rotorfit[mat73]'",
    "ulog": "PX4 log (.ulg)",
    "dataflash": "ArduPilot log (.bin), with TimeUS, TimeMS or no time",
    "dataflash_text": "ArduPilot log as text (.log)",
    "parquet": "Parquet: one flat table (.parquet)",
    "motive": "OptiTrack Motive export (.csv), format 1.2 and later",
    "vicon": "Vicon export (.csv) of Tracker or Nexus",
    "csv": "CSV: a row of names, then rows of numbers between commas, semicolons or tabs",
}
"""Format to what a user calls it."""


def cards_view(cards: Mapping[str, Card]) -> View:
    """Built-in cards: name, vehicle, columns."""
    for name, card in cards.items():
        yield title(f"{name}: {card.name}")
        yield indented(f"commands: {_columns({'time': card.command_time, **card.command})}")
        yield indented(f"pose: {_columns({'time': card.pose_time, **card.pose})}")


def _columns(channels: Mapping[str, Channel]) -> str:
    """Columns with the table named once."""
    tables = {split_source(channel.source)[0] for channel in channels.values()}
    if len(tables) > 1:
        return ", ".join(str(channel.source) for channel in channels.values())
    names = ", ".join(split_source(channel.source)[1] for channel in channels.values())
    table = next(iter(tables))
    return f"{table}: {names}" if table else names


def formats_view(formats: Iterable[str]) -> View:
    """Formats of logs that can be read."""
    out = table("format", "what it is", left=(0, 1))
    for name in formats:
        out.add_row(name, FORMATS[name])
    yield out
    yield Text("A format is found by content, not by name.", style="dim")
