"""Exact spherical surfaces of rigid bodies as candidates."""
