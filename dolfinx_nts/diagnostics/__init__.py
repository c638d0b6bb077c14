"""Energies, momenta, contact and penetration of an accepted state, and their changes in a run."""
