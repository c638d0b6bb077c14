"""Energies, momenta and penetration of an accepted state."""
