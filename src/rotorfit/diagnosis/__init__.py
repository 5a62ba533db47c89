"""What can be said of the data before any fit: which card fits, what is wrong with clocks, poses, commands and
frames.

In go Log, Card and Flight; out come findings, a survey, a proposed or drafted card.
"""
