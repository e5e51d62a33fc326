"""Configure the documentation site: guide, notebook, and pages that `_site` makes from the code."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from _site.reference import ROOMS  # noqa: E402

from activestructure_gym._version import __version__  # noqa: E402

project = "ActiveStructure Gym"
author = "the ActiveStructure Gym developers"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "_site"]
exclude_patterns = ["README.md", "package_index.md", "_site"]
master_doc = "index"

# Single backticks in docstrings mark code.
default_role = "code"
myst_heading_anchors = 4  # headings up to level 4 get anchors as on GitHub, so links to headings are checked
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_use_rtype = False
nitpicky = True  # warn about names that cannot be resolved; the pattern below excepts names without an entry
nitpick_ignore_regex = [(r"py:.*", rf"(?!(?:{'|'.join(map(re.escape, ROOMS))})\.[A-Z]\w+$).*")]
linkcheck_timeout = 20  # seconds per link in docs/build --links

html_theme = "furo"
html_title = f"ActiveStructure Gym {__version__}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_theme_options = {
    "navigation_with_keys": True,
    "light_css_variables": {"color-brand-primary": "#0072b2", "color-brand-content": "#0072b2"},
    "dark_css_variables": {"color-brand-primary": "#56b4e9", "color-brand-content": "#56b4e9"},
}
