"""Statics: equilibria at the ends of steps, and continuation where there is none nearby."""
