"""The frequency response that a flight shows by itself, beside the model's, and the test of the law against it."""
