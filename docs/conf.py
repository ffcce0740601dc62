"""Settings of the site: `python -m sphinx -W -n -b html docs site` builds it (extra `docs`)."""

import re
import sys
from pathlib import Path

import latex2mathml.converter
from docutils.nodes import SkipNode

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

import from_code  # noqa: E402  # these two folders have to be on the path first

import rainsim  # noqa: E402

project = "rainsim"
copyright = "the authors of rainsim, Apache-2.0"
version = release = rainsim.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode", "numpydoc"]
exclude_patterns = ["site", "_build"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_math_renderer = "mathml"
highlight_language = "none"  # of blocks that name no language: commands
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
smartquotes_action = "qe"  # two hyphens begin an option and stay two
html_title = f"rainsim {release}"
html_show_sphinx = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings have types, with shapes and units
numpydoc_show_class_members = False
# The types in docstrings are words for people: shapes, units, names of other modules.
nitpick_ignore_regex = [("py:.*", ".*")]
linkcheck_timeout = 10


def formula(node, display):
    """Return a formula as MathML, which browsers draw without a script from elsewhere."""
    return latex2mathml.converter.convert(node.astext(), display=display)


def visit_inline(writer, node):
    """Write a formula within a line."""
    writer.body.append(formula(node, "inline"))
    raise SkipNode


def visit_block(writer, node):
    """Write a formula that stands by itself."""
    writer.body.append(f'<div class="math">{formula(node, "block")}</div>')
    raise SkipNode


def keep_options(app, page, template, context, doctree):
    """Mark the options in commands, which else break after their hyphens."""

    def marked(block):
        words = re.sub(r"(?<!\S)-[^\s<]+", r'<span class="option">\g<0></span>', block[2])
        return block[1] + words + block[3]

    if "body" in context:
        blocks = r'(<div class="highlight-none.*?<pre>)(.*?)(</pre>)'
        context["body"] = re.sub(blocks, marked, context["body"], flags=re.S)


def setup(app):
    """Fill in what comes from the code before a page is read; draw formulas as MathML."""
    app.connect("source-read", from_code.fill)
    app.connect("html-page-context", keep_options)
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
