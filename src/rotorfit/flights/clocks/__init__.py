"""Stamps and clocks: when a sample was taken, by which clock, and the offset between two clocks."""
