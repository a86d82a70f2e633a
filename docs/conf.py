"""Settings of the documentation: `python -m sphinx -W docs site` builds it without a network."""

from pathlib import Path

import tryon_jax

project = "tryon_jax"
author = "the tryon_jax authors"
project_copyright = "2026, the tryon_jax authors"
version = release = tryon_jax.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax", "sphinx.ext.viewcode"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
# Pages around what experiments and benchmarks write: they are there once these were run.
MADE = ("simulator", "RESULTS", "BENCHMARKS", "cost")
html_theme = "furo"
html_title = "tryon_jax"
html_static_path = ["images"]

autodoc_default_options = {"members": True, "member-order": "bysource", "undoc-members": False}
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_display_short_literal_types = True
# Docstrings are Google style with Args, Returns and Raises.
napoleon_numpy_docstring = False
# A single pair of backquotes in our docstrings is code.
default_role = "code"


def plain_bars(_app, _what, _name, _object, _options, lines):
    """Let |x| in docstrings be an absolute value and no substitution."""
    lines[:] = [line.replace("|", "\\|") for line in lines]


def leave_out_pages_not_made(app, docname, source):
    """Drop pages from the index that no program has written yet."""
    if docname == "index":
        absent = {name for name in MADE if not (Path(app.srcdir) / f"{name}.md").exists()}
        source[0] = "\n".join(line for line in source[0].split("\n") if line not in absent)


def setup(app):
    """Hook into Sphinx."""
    app.connect("source-read", leave_out_pages_not_made)
    app.connect("autodoc-process-docstring", plain_bars)
