"""Contact pairs: declarations, state, and forces of a step."""
