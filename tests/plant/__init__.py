"""Tests of the plant: structure, parameters, and the two back ends."""
