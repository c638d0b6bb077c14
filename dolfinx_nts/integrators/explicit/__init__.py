"""Explicit stepper: central differences with lumped mass."""
