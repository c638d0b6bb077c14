"""Friction: laws, and the traction of a slipping node."""
