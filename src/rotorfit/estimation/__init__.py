"""Estimation: the likelihood, the paper's regression and the methods between them, behind one table of methods.

In go Flights; out comes a Fit with coefficients, intervals, statuses and profiles.
"""
