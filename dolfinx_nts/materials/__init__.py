"""Hyperelastic materials."""
