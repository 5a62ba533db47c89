"""What a fit says against itself: residual variance, spread between flights, refutation.

In go estimates of the likelihood; out come intervals of these flights and of the vehicle, and the evidence behind them.
"""
