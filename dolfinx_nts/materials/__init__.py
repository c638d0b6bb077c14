"""Hyperelastic materials: their strain energies and the stresses that follow from them."""
