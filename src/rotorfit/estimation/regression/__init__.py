"""The paper's regression, and the methods (rungs) between it and the likelihood."""
