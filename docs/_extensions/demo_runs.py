"""Runs the demos whose results are not known yet, several at a time, before pages are read.

Sphinx would run them one after the other. One that fails is left to it, which tells the error.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jupytext
from jupyter_cache import get_cache
from jupyter_cache.base import CacheBundleIn
from jupyter_cache.executors.utils import single_nb_execution
from sources import as_notebook
from sphinx.application import Sphinx

__all__ = ["setup"]

# More demos at a time would need much memory.
_MOST = 4


def setup(app: Sphinx) -> dict[str, bool]:
    """Run demos when the build begins."""
    app.connect("builder-inited", _run)
    return {"parallel_read_safe": True}


def _run(app: Sphinx) -> None:
    """Put results into the cache from which MyST-NB takes them, unless execution is off."""
    if app.config.nb_execution_mode == "off":
        return
    cache, new = get_cache(app.config.nb_execution_cache_path), {}
    _, options = app.config.nb_custom_formats[".py"]
    for path in sorted(Path(app.srcdir, "demos").rglob("*.py")):
        notebook = jupytext.reads(as_notebook(path.read_text(), path.stem), **options)
        try:
            cache.match_cache_notebook(notebook)
        except KeyError:
            new[path] = notebook

    def executed(notebook: Any) -> Any:
        with TemporaryDirectory() as folder:
            timeout = app.config.nb_execution_timeout
            return single_nb_execution(notebook, folder, timeout, allow_errors=False)

    with ThreadPoolExecutor(min(os.cpu_count() or 1, _MOST)) as pool:
        for path, result in zip(new, pool.map(executed, new.values()), strict=True):
            if result.err is None:
                data = {"execution_seconds": result.time}
                bundle = CacheBundleIn(result.nb, str(path), data=data)
                cache.cache_notebook_bundle(bundle, check_validity=False, overwrite=True)
