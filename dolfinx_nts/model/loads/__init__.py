"""Loads on bodies and surfaces, and their resultants."""
