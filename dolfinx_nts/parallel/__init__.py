"""MPI: reductions, communication, errors and signals."""
