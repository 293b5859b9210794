"""Gains tuned from one experiment on a closed loop, kept stable by what the record says."""
