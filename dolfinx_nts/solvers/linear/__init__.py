"""Linear systems of Newton's method: Krylov methods, elimination, complete systems."""
