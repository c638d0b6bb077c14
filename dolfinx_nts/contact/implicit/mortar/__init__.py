"""Mortar contact in one attempt at a step: multipliers with shape functions on facets."""
