"""Simulated kill of a program at any instant of writing files."""

import os

from dolfinx_nts.io import atomic_file, shared_file
from dolfinx_nts.io.formats import xml_series


class Killed(BaseException):
    """Exception that simulates a kill: no more code of the program runs."""


def kill_at(monkeypatch, count):
    """Kill at the n-th change of the disk; a write is cut in the middle."""
    calls = 0

    def counted(owner, name, half):
        function = getattr(owner, name)

        def call(*arguments, **options):
            nonlocal calls
            calls += 1
            if calls == count:
                if half:
                    *others, data = arguments
                    function(*others, data[: len(data) // 2])
                raise Killed
            return function(*arguments, **options)

        monkeypatch.setattr(owner, name, call)

    create = atomic_file.created_temporary

    def half_written(path):
        nonlocal calls
        calls += 1
        is_last = calls == count
        file = create(path)
        if is_last:
            with file:
                file.write(b"half of the new content")
            raise Killed
        return file

    monkeypatch.setattr(atomic_file, "created_temporary", half_written)
    counted(xml_series, "_put", True)
    counted(shared_file, "_put", True)
    for name in ("replace", "rename", "unlink", "mkdir"):
        counted(os, name, False)
