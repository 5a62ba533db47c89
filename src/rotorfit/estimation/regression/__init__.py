"""The paper's regression, and the methods between it and the likelihood."""
