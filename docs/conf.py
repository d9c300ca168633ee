"""Sphinx configuration of the documentation: `make docs` builds it, offline, with warnings as errors."""

import os
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "src"))

project = "OmniDepth-Occ"
author = "the OmniDepth-Occ developers"
version = release = installed_version("omniocc")
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx_copybutton",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["results/report/**", "_build"]
myst_enable_extensions = ["deflist", "colon_fence"]
myst_heading_anchors = 4
highlight_language = "text"
suppress_warnings = ["ref.python"]  # a name that a package exports again has two entries; either will do

autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

# links to other projects' references need the network: DOCS_ONLINE=1 make docs
intersphinx_mapping = (
    {
        "python": ("https://docs.python.org/3", None),
        "torch": ("https://docs.pytorch.org/docs/stable", None),
        "lightning": ("https://lightning.ai/docs/pytorch/stable", None),
        "torchmetrics": ("https://lightning.ai/docs/torchmetrics/stable", None),
    }
    if os.environ.get("DOCS_ONLINE") == "1"
    else {}
)

html_theme = "furo"
html_title = "OmniDepth-Occ"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = False


def escape_markup(app: Any, what: str, name: str, documented: Any, options: Any, lines: list[str]) -> None:
    """Escape the star of shapes such as `(B, *shape)`, which is no emphasis, and the bars of `|x|`, no substitution."""
    stars = (re.sub(r"(?<![*\w\\`])\*(?=[A-Za-z]\w*\b(?!\*))", r"\\*", line) for line in lines)
    lines[:] = [re.sub(r"\|(\w+)\|", r"\\|\1\\|", line) for line in stars]


def skip_fields(app: Any, what: str, name: str, documented: Any, skip: bool, options: Any) -> bool | None:
    """Leave out the fields of named tuples, which the class's own docstring explains."""
    return True if str(documented.__doc__).startswith("Alias for field number") else None


def hide_old_names(app: Any, what: str, name: str, documented: Any, skip: bool, options: Any) -> None:
    """Show functions without the old names of their arguments (`rayiou.renamed`); leave nothing out."""
    if hasattr(documented, "__wrapped__"):
        vars(documented).pop("__signature__", None)


def setup(app: Any) -> None:
    """Register what happens to docstrings and signatures."""
    app.connect("autodoc-skip-member", hide_old_names, priority=100)
    app.connect("autodoc-skip-member", skip_fields)
    app.connect("autodoc-process-docstring", escape_markup, priority=900)
