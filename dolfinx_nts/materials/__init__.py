"""Materials: strain energies and their stresses, viscous branches and plastic flow."""
