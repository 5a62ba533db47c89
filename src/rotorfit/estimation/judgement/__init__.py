"""Judgement of a fit by its own data: residual variance, spread between flights, refutation of the law.

In go estimates of the likelihood; out come intervals of these flights and of the vehicle, and the evidence behind them.
"""
