"""Tangential forces of contact in one attempt at a step."""
