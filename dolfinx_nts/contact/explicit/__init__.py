"""Contact by penalty springs in explicit steps."""
