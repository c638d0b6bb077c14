"""Progress of a run on the terminal."""

from typing import Any

from mpi4py import MPI

from tqdm import tqdm

__all__ = ["progress"]


def progress(comm: MPI.Comm, total: float, **options: Any) -> Any:
    """Bar on the terminal of rank 0, if it takes longer than a second. Local.

    Args:
        comm: Communicator of the run.
        total: What is to be done.
        options: Those of tqdm: the unit, for instance.

    Returns:
        The bar, a context; its method ``update`` takes what has been done.
    """
    # None: where there is a terminal.
    silent = None if comm.rank == 0 else True
    return tqdm(total=total, delay=1, leave=False, disable=silent, **options)
