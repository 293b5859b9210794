"""Rigs whose truth is known: records of hidden effects, made without MuJoCo and without physid."""
