"""How the documentation is built. Only npm uses the network, for the page in `web/`."""

import runpy
import shutil
from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.logging import getLogger

project = "Caterpillar"
author = "the authors of Caterpillar"
version = release = installed_version("caterpillar-sma")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "Caterpillar"
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False

myst_heading_anchors = 4  # page.md#a-heading works as it does on GitHub

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_default_options = {"members": True}
autodoc_mock_imports = ["ray"]  # extras, which the signatures do without
autodoc_preserve_defaults = True
default_role = "py:obj"  # `Name` in a docstring is a link where there is something to link to
napoleon_numpy_docstring = False


def _before_napoleon(
    app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]
) -> None:
    """Keep docstrings from being read as what they are not."""
    if what in ("attribute", "data", "property"):
        if lines and lines[0].startswith("Alias for field number"):
            lines.clear()  # what Python says of a field of a NamedTuple that nobody documents
        lines[:0] = [
            "..",
            "",
        ]  # else "full: every spring" on the first line is a type and its description


_web = runpy.run_path(str(Path(__file__).parents[1] / "web" / "build.py"))


def _add_page(app: Sphinx, error: Exception | None) -> None:
    """Build the page in `web/` and add it to the site."""
    if error is None and app.builder.format == "html" and app.tags.has("page"):
        shutil.copytree(_web["build_page"](), Path(app.outdir, "crawl"), dirs_exist_ok=True)


def setup(app: Sphinx) -> None:
    """Connect the above."""
    app.connect("autodoc-process-docstring", _before_napoleon, priority=1)
    app.connect("build-finished", _add_page)
    if _web["find_npm"]() is not None:
        app.tags.add("page")
    else:
        getLogger(__name__).info("without Node, the site has no page in which the robot crawls")
