"""A vehicle that is followed while it flies: where its states and alarms go, besides the terminal."""
