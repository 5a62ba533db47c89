"""Tracking: the model while the vehicle flies, and an alarm when it is another vehicle.

In go samples as they come, or a recorded Flight as if they did; out come Tracked each second, Alarms, and the Regimes
of the flight with their Models. Nothing is sent to a vehicle.
"""
