"""Stress suite: scenes that provoke wrong results or failures, see `run`."""
