"""Flights to Fit: the likelihood, the paper's regression and the methods between, behind one table of methods.

In go Flights; out comes a Fit with coefficients, intervals, statuses and profiles.
"""
