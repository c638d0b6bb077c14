"""What ranks do together by MPI: reductions, communication, errors and signals."""
