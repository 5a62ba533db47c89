"""Writes the two simulated flights of the README's five minutes, flight1.csv and flight2.csv, into this folder."""

import csv
from pathlib import Path

import numpy as np

from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Controller, SimulatedFlight, Truth, simulate_flight


def write(flight: SimulatedFlight, path: Path) -> None:
    """One table, a row a sample: poses (yaw in degrees, wrapped) and commands, blank where the row has none."""
    yaw = np.degrees(np.angle(np.exp(1j * flight.pose[:, 3])))
    poses = [
        (t, [*(f"{value:.5f}" for value in pose[:3]), f"{heading:.3f}", "", "", "", ""])
        for t, pose, heading in zip(flight.pose_stamp, flight.pose, yaw, strict=True)
    ]
    sent = [
        (t, ["", "", "", "", *(f"{value:.4f}" for value in values)])
        for t, values in zip(flight.command_stamp, flight.command, strict=True)
    ]
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time", "x", "y", "z", "yaw", "cmd_x", "cmd_y", "cmd_z", "cmd_yaw"])
        table.writerows([f"{1e-9 * t:.6f}", *cells] for t, cells in sorted(poses + sent, key=lambda row: row[0]))


def two_flights(folder: Path, durations: tuple[float, float] = (90.0, 60.0)) -> None:
    """A vehicle held in place while it flies the paper's two sines on all axes at once."""
    for number, duration in enumerate(durations, 1):
        flight = simulate_flight(Truth(), two_sines, duration, 10 + number, controller=Controller(0.3, 0.5))
        write(flight, folder / f"flight{number}.csv")


if __name__ == "__main__":
    two_flights(Path())
