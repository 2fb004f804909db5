"""Sphinx: ``make docs`` executes the tutorials and turns warnings into errors."""

import importlib.util
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import drive_id

project = "drive_id"
author = "drive_id maintainers"
copyright = "drive_id maintainers"  # noqa: A001  # Sphinx's name
version = release = drive_id.__version__

# MathJax from this package instead of the network, which benches often lack.
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx-mathjax-offline"]
exclude_patterns = ["_build", "requirements.txt"]
html_theme = "furo"
html_title = f"drive_id {version}"
html_show_sourcelink = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "substitution"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True

missing = [name for name in ("rclpy", "drive_id_msgs") if importlib.util.find_spec(name) is None]
live = "This page is executed when the documentation is built."
if missing:
    live = (
        f"This page was not executed when this documentation was built, because {' and '.join(missing)} "
        "could not be imported: `make docs` installs both."
    )
    nb_execution_excludepatterns = ["live.md"]
    sys.stderr.write(f"docs/live.md: {live}\n")
myst_substitutions = {"live": live}

autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_mock_imports = ["rclpy", "diagnostic_msgs", "drive_id_msgs", "rcl_interfaces", "std_srvs"]
napoleon_google_docstring = False
napoleon_use_rtype = False
suppress_warnings = [
    "myst.xref_missing",  # links to files outside this folder, which the pages have for readers of the repository
]
