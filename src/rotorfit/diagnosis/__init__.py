"""Diagnosis of the data before any fit: which card fits, and faults of clocks, poses, commands and frames.

In go Log, Card and Flight; out come findings, a survey, a proposed or drafted card.
"""
