"""Massless nodes of resolved impact: redistributed mass, static equilibrium."""
