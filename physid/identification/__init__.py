"""Belief fitted to measurement: output error, force balance, noise, uncertainty."""
