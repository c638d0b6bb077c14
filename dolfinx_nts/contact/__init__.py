"""Contact pairs: what is declared, what is remembered, and the forces of a step."""
