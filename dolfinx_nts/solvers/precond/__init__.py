"""Preconditioners: factors of the bulk tangent, and their corrections around contacts."""
