"""Pieces of scripts/seated_driver_lmi.py: the rig and its noise, and one module per kind of figure."""
