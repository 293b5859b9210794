"""The rigs against the papers' true parameters."""
