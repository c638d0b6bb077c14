"""Errors and costs of contact laws and methods in scenes of users, from which defaults follow."""
