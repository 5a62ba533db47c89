"""Which flight to fly next: excitation signals, optimal designs, envelope, expected precision.

In go a belief about the vehicle and the room; out comes a Plan with its predictions.
"""
