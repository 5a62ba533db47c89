"""Tracking: the model while the vehicle flies, and an alarm when the vehicle has changed.

Samples go in as they arrive, or a recorded Flight as if it were live; a Tracked each second, Alarms, and the Regimes of
the flight with their Models come out. Nothing is sent to a vehicle.
"""
