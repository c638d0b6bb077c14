"""Newton's method and its linear systems, with PETSc."""
