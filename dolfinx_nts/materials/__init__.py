"""Hyperelastic materials: strain energies and stresses derived from them."""
