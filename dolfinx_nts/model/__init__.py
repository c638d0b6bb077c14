"""Declarations of users except contact: bodies, surfaces, obstacles, loads, supports."""
