"""The virtual flight room (a rigid body with attitude loops, radio, sensors and wind) and the paper's vehicle.

In go a vehicle, the air and commands; out come poses and the truth behind them. It shares no formula with the
estimator, so that the estimator is not tested against itself.
"""
