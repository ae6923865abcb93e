"""Configuration of the documentation's site: run ``make docs``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from oppload_cli.version import __version__

project = "oppload"
author = "The oppload developers"
version = release = __version__
extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_design",
    "tools.site",
]
smartquotes = False  # they would turn -- of an option into a dash
exclude_patterns = ["_build", "*.in.md", "examples"]
suppress_warnings = ["autosummary.import_cycle"]

# Pages: links lead to headings as on a code host.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
myst_links_external_new_tab = True

# Python: a page per public name; the page of a class has its methods.
templates_path = ["_templates"]
autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False
toc_object_entries_show_parents = "hide"

copybutton_exclude = ".linenos, .gp, .go"
copybutton_selector = "div:not(.output) > div.highlight > pre"

html_theme = "pydata_sphinx_theme"
html_title = f"oppload {release}"
html_logo = None
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": "oppload"},
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "header_links_before_dropdown": 6,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "github-dark",
}
if versions := os.environ.get("OPPLOAD_DOCS_VERSIONS"):  # set where a site is published
    html_theme_options |= {
        "switcher": {"json_url": versions, "version_match": release},
        "check_switcher": False,
        "navbar_end": ["version-switcher", "theme-switcher"],
    }
project_copyright = f"{author}, BSD-3-Clause"
