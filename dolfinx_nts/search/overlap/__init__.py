"""Overlap check: bodies inside each other or inside themselves."""
