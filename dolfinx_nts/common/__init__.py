"""Helpers that know nothing of meshes: array types, argument checks, archives, wall time."""
