"""Helpers without meshes: array types, argument checks, archives, wall time."""
