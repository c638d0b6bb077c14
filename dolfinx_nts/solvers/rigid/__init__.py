"""Rigid bodies in Newton's method: six unknowns each, their states and guides."""
