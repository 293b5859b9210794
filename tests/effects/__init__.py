"""Tests of the effects: laws, places, neutral values, files."""
