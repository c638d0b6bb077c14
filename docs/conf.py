"""Settings of the documentation site, which ``make docs`` builds."""

import hashlib
import os
import sys
from pathlib import Path

import dolfinx_nts

_ROOT = Path(__file__).parents[1]
_PACKAGE = _ROOT / "dolfinx_nts"
sys.path.insert(0, str(_ROOT / "docs" / "_extensions"))


def _digest(folder: Path) -> str:
    """Digest of the sources in a folder: demos run again when the package is another."""
    sources = sorted(path for path in folder.rglob("*") if path.suffix in (".py", ".h", ".cpp"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:12]


project = "dolfinx_nts"
author = "The dolfinx_nts developers"
copyright = f"2026, {author}"
version = release = dolfinx_nts.__version__

extensions = [
    "api_pages",
    "demo_runs",
    "sources",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",
    "sphinx_copybutton",
    "sphinx_design",
    "myst_nb",
]
exclude_patterns = ["_extensions", "conf.py", "figures.py", "tables"]

# Demos are scripts, which become notebooks.
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:light"}]}
nb_execution_mode = "cache"
nb_execution_cache_path = str(_ROOT / "build" / "docs" / "notebooks" / _digest(_PACKAGE))
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
nb_output_stderr = "remove"
# Of tqdm, which misses widgets in notebooks.
os.environ["PYTHONWARNINGS"] = "ignore"
# Kernels warn that they talk to us without encryption, on one machine.
_PROFILE = _ROOT / "build" / "docs" / "ipython" / "profile_default"
_PROFILE.mkdir(parents=True, exist_ok=True)
(_PROFILE / "ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 'ERROR'\n")
os.environ["IPYTHONDIR"] = str(_PROFILE.parent)

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3

# `Name` is a link to the object of this name.
default_role = "any"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

html_theme = "pydata_sphinx_theme"
html_title = f"dolfinx_nts {release}"
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
# Pages without a sidebar.
html_sidebars = {"gallery": [], "index": []}
html_theme_options = {
    "header_links_before_dropdown": 8,
    "navbar_align": "left",
    "navbar_persistent": ["search-button"],
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "show_nav_level": 2,
}
