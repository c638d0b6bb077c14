"""Rigid obstacles, with an exact surface or with facets, and their motion."""
