"""Checks of contact at the start and during a run: penetration, pass-through, energy gain."""
