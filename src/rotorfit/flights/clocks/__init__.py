"""Stamps and clocks: when a sample was taken, by which clock, and how far two clocks are apart."""
