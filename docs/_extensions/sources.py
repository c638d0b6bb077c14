"""What is changed in sources when Sphinx has read them.

Demos, which become notebooks, lose the docstring, which repeats the title, and get links to
download them. Links from pages to files of code become downloads, as only pages are in the site.
"""

import re

from sphinx.application import Sphinx

__all__ = ["as_notebook", "setup", "with_downloads"]


def setup(app: Sphinx) -> dict[str, bool]:
    """Change each source when Sphinx has read it."""
    app.connect("source-read", _change)
    return {"parallel_read_safe": True}


def as_notebook(script: str, name: str) -> str:
    """Put links below the title of a demo, and leave out its docstring.

    Args:
        script: Text of the demo: a docstring, then the title in a comment.
        name: Name of its file, without suffix.

    Returns:
        Text to make the notebook of.
    """
    _, body = script.split("\n\n", 1)
    title, remainder = body.split("\n", 1)
    links = f"{{nb-download}}`notebook <{name}.ipynb>` {{download}}`script <{name}.py>`"
    return f"{title}\n#\n# {links}\n{remainder}"


def with_downloads(page: str) -> str:
    """Make links to files of code downloads.

    Args:
        page: Text in Markdown.

    Returns:
        The text, where ``[a.py](../a.py)`` is a role.
    """
    return re.sub(r"\[([^]]+)\]\((\S+\.(?:py|h))\)", r"{download}`\1 <\2>`", page)


def _change(app: Sphinx, docname: str, source: list[str]) -> None:
    folder, _, name = docname.rpartition("/")
    if folder.split("/")[0] == "demos":
        source[0] = as_notebook(source[0], name)
    elif app.env.doc2path(docname).suffix == ".md":
        source[0] = with_downloads(source[0])
