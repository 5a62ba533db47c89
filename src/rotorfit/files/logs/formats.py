"""Formats: every kind of log that can be read. Command line and studio build their lists from this table.

A new format is a module with `sniff(path, head) -> bool` and `read(path, tables) -> Content`, and one row here.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Format:
    """A kind of log.

    Attributes:
        label: Name for users.
        files: Its files, for a list.
        module: Module that reads it, imported on demand.
        ned: Whether it is an autopilot's log, whose world frame is north, east, down.
        rows: Whether a table may hold several streams, with blank cells in each row.
    """

    label: str
    files: str
    module: str
    ned: bool = False
    rows: bool = False

    @property
    def text(self) -> str:
        """Label and files."""
        return f"{self.label}: {self.files}"


_LOGS = "rotorfit.files.logs"

FORMATS: Mapping[str, Format] = {
    "rosbag1": Format("ROS 1 bag", ".bag", f"{_LOGS}.rosbag1"),
    "rosbag2": Format("ROS 2 bag", "its folder, or a lone .db3", f"{_LOGS}.rosbag2"),
    "mcap": Format("MCAP", ".mcap with ROS messages, encodings cdr and ros1", f"{_LOGS}.mcap"),
    "mat": Format("MATLAB", ".mat, version 5 to 7.2, also from Octave and scipy", f"{_LOGS}.mat", rows=True),
    "mat73": Format(
        "MATLAB 7.3", ".mat, version 7.3; needs h5py: pip install 'rotorfit[mat73]'", f"{_LOGS}.mat73", rows=True
    ),
    "ulog": Format("PX4 log", ".ulg", f"{_LOGS}.ulog", ned=True),
    "dataflash": Format("ArduPilot log", ".bin, with TimeUS, TimeMS or no time", f"{_LOGS}.dataflash", ned=True),
    "dataflash_text": Format("ArduPilot log as text", ".log", f"{_LOGS}.dataflash_text", ned=True),
    "parquet": Format("Parquet", ".parquet, one flat table", f"{_LOGS}.parquet", rows=True),
    "motive": Format("OptiTrack Motive export", ".csv, format 1.2 and later", f"{_LOGS}.motive"),
    "vicon": Format("Vicon export", ".csv of Tracker or Nexus", f"{_LOGS}.vicon"),
    "jsonl": Format("JSON Lines", "one JSON object a line, nested or with short lists", f"{_LOGS}.jsonl", rows=True),
    "csv": Format(
        "CSV", "a row of names, then rows of numbers between commas, semicolons or tabs", f"{_LOGS}.csv", rows=True
    ),
}
"""Name to format, in the order of sniffing: formats with a signature first, CSV, which has none, last."""
