"""Energies, momenta and penetration of an accepted state, and how they change in a run."""
