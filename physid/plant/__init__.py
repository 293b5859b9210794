"""What is believed of a rig: structure, parameters, effects, and its simulation."""
