"""Stress suite: scenes that try to make a run lie or break, see `run`."""
