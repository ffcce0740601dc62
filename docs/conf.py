"""Settings of the site: `python -m sphinx -W -n -b html docs site` builds it (extra `docs`)."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import from_code  # noqa: E402  # these two folders have to be on the path first

import rainsim  # noqa: E402

project = "rainsim"
copyright = "the authors of rainsim, Apache-2.0"
version = release = rainsim.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "numpydoc"]
exclude_patterns = ["site", "_build"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"rainsim {release}"
html_show_sphinx = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings have types, with shapes and units
numpydoc_show_class_members = False
# The types in docstrings are words for people: shapes, units, names of other modules.
nitpick_ignore_regex = [("py:.*", ".*")]
linkcheck_timeout = 10


def setup(app):
    """Fill in what comes from the code before a page is read."""
    app.connect("source-read", from_code.fill)
