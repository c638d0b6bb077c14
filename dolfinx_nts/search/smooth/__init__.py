"""Smooth surfaces: cubic patches on facets as candidates."""
