"""User declarations except contact pairs: bodies, surfaces, obstacles, loads, supports."""
