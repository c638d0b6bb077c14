"""HDF5 files that all ranks write, read by HDF5."""

import errno
import os
import resource

from mpi4py import MPI

import h5py
import numpy as np
import pytest

from dolfinx_nts.io.shared_file import write_hdf5
from dolfinx_nts.parallel.slabs import Slab
from helpers.killed import Killed, kill_at

pytestmark = pytest.mark.at_most_two_ranks


def rows(comm, whole):
    """Slab of this rank; the first has none if there are several."""
    ends = np.linspace(0, len(whole), max(comm.size, 2)).astype(int)
    ends = [0, *ends] if comm.size > 1 else ends
    begin, end = ends[comm.rank : comm.rank + 2]
    return Slab(whole[begin:end], int(begin), len(whole))


def test_hdf5_reads_files_written_by_all_ranks(comm, folder, agree):
    path, x, flags = folder / "a.h5", np.arange(21.0).reshape(7, 3), np.arange(5) % 2 > 0
    arrays = {
        "x": [rows(comm, x), rows(comm, -x)],
        "group/flags": [rows(comm, flags)],
        "nothing": [rows(comm, np.empty((0, 3)))],
        f"own/{comm.rank}": [Slab.whole(np.arange(comm.rank + 1, dtype=np.int32))],
    }
    if comm.rank == 0:
        arrays["number"] = [Slab.whole(np.array(0.5))]
    attributes = {"time": 0.1, "name": "ä", "steps": (1, 2)}
    for durable in (False, True):
        write_hdf5(comm, path, arrays, attributes, durable=durable)
    comm.barrier()
    with h5py.File(path) as file:
        assert agree(np.array_equal(file["x"], np.concatenate([x, -x])))
        assert agree(np.array_equal(file["group/flags"], flags) and file["x"].dtype == float)
        assert agree(file["nothing"].shape == (0, 3) and file["number"][()] == 0.5)
        for rank in range(comm.size):
            own = file[f"own/{rank}"]
            assert agree(own.dtype == np.int32 and len(own) == rank + 1)
            assert agree(np.array_equal(own, np.arange(rank + 1)))
        found = {key: np.asarray(value).tolist() for key, value in file.attrs.items()}
        assert agree(found == {"time": 0.1, "name": "ä", "steps": [1, 2]})
    comm.barrier()
    assert agree(list(folder.iterdir()) == [path])


def test_many_names_find_room(comm, folder, agree):
    whole = {f"group {n % 7}/{n}": np.arange(n + 1.0) for n in range(300)}
    write_hdf5(comm, folder / "a", {of: [rows(comm, a)] for of, a in whole.items()}, {})
    comm.barrier()
    with h5py.File(folder / "a") as file:
        assert agree(all(np.array_equal(file[name], array) for name, array in whole.items()))


def test_an_error_leaves_the_former_file_and_no_other(comm, folder, refused, agree):
    path = folder / "a"
    if comm.rank == 0:
        path.mkdir()
        (path / "mine").touch()
    comm.barrier()
    with refused(OSError, "Is a directory; a file of this name from before is unchanged"):
        write_hdf5(comm, path, {"x": [rows(comm, np.ones(4))]}, {})
    comm.barrier()
    assert agree([p.name for p in folder.iterdir()] == ["a"])


def test_an_error_on_one_rank_is_one_on_all(comm, folder, refused, monkeypatch):
    if comm.rank == comm.size - 1:
        monkeypatch.setattr(
            "dolfinx_nts.io.shared_file._pieces", lambda *_: map(os.stat, [folder / "nowhere"])
        )
    with refused(FileNotFoundError, "No such file"):
        write_hdf5(comm, folder / "a", {"x": [rows(comm, np.ones(4))]}, {})


@pytest.mark.parametrize("exists", [True, False])
def test_a_full_disk_has_the_message_of_one_rank(comm, folder, agree, exists):
    path, slabs = folder / "a", {"x": [rows(comm, np.ones(20000))]}
    if exists:
        write_hdf5(comm, path, {}, {})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    if comm.rank == comm.size - 1:
        resource.setrlimit(resource.RLIMIT_FSIZE, (50000, limits[1]))
    try:
        with pytest.raises(OSError) as caught:
            write_hdf5(comm, path, slabs, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    kept = "; a file of this name from before is unchanged" if exists else ""
    assert agree(caught.value.errno == errno.EFBIG)
    assert agree(caught.value.strerror == f"{os.strerror(errno.EFBIG)}{kept}")
    comm.barrier()
    assert agree(list(folder.iterdir()) == [path] * exists)


def test_no_link_is_followed(comm, folder, agree):
    mine, path = folder / "mine", folder / "a"
    if comm.rank == 0:
        mine.write_bytes(b"precious")
        path.with_name("a.new").symlink_to(mine)
    comm.barrier()
    write_hdf5(comm, path, {"x": [rows(comm, np.ones(4))]}, {})
    comm.barrier()
    assert agree(mine.read_bytes() == b"precious" and not path.is_symlink())


@pytest.mark.serial
@pytest.mark.parametrize("exists", [True, False])
def test_a_kill_at_any_instant_leaves_the_former_file_or_the_new_one(tmp_path, monkeypatch, exists):
    path, count, found = tmp_path / "a", 0, []
    while not found or found[-1] != [1.0, 1.0]:
        count += 1
        path.unlink(missing_ok=True)
        if exists:
            write_hdf5(MPI.COMM_SELF, path, {"x": [Slab.whole(np.zeros(3))]}, {})
        with monkeypatch.context() as patch:
            kill_at(patch, count)
            try:
                write_hdf5(MPI.COMM_SELF, path, {"x": [Slab.whole(np.ones(2))]}, {})
            except Killed:
                pass
        found.append(h5py.File(path)["x"][()].tolist() if path.exists() else None)
    assert count > 3 and found[:-1] == (count - 1) * [[0.0] * 3 if exists else None]
