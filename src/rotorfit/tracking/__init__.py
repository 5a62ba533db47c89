"""Tracking: the model while the vehicle flies, and an alarm when it is another vehicle."""
