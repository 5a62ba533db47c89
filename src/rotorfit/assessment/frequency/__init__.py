"""The frequency response that a flight itself shows, beside the model's, and the test of the law against it."""
