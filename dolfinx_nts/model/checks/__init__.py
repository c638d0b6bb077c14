"""Checks of the declared bodies: cells, locking, velocities."""
