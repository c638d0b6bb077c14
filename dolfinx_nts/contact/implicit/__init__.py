"""Contact within one attempt at an implicit step."""
