"""Gymnasium environments over physid's rigs.

The environments come with the next release; this package holds their name.
"""
