"""MPI: reductions, communication, errors and signals on all ranks."""
