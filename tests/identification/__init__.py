"""Tests of identification: noise, fits, uncertainty, force balance, what is free."""
