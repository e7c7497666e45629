"""Sphinx configuration.

Every page is one text file. Notebooks run at each build. The pages load nothing from other sites.
Mathematics is MathML, and its font is stored with the pages.
"""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

from sphinx.application import Sphinx

from mcspectra.version import __version__

project = "mcspectra"
author = "The mcspectra authors"
copyright = author  # Sphinx requires this name
release = version = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "bibliography",
    "docstrings",
    "mathml",
    "terms",
    "verbs",
]
exclude_patterns = ["_extensions", "_build", "**/.ipynb_checkpoints"]
# Sphinx warns with ref.python if a name such as `dims` is an attribute of several classes.
suppress_warnings = ["myst.header", "ref.python"]

myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
myst_links_external_new_tab = False
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_ipywidgets_js = {}  # Sphinx's default would load a script from another site
nb_merge_streams = True
nb_output_stderr = "remove"  # progress bars are written to stderr

autodoc_typehints = "none"  # no types in descriptions, because signatures show them
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
default_role = "py:obj"
add_module_names = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90
highlight_language = "default"

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "mcspectra"
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
html_static_path = ["_static"]
html_css_files = ["mcspectra.css"]


def setup(_app: Sphinx) -> None:
    """Let notebook cells find the commands of this environment, and print plain text."""
    commands = str(Path(sys.executable).parent)
    os.environ["PATH"] = os.pathsep.join([commands, os.environ.get("PATH", "")])
    os.environ.update(COLUMNS="90", NO_COLOR="1", TERM="dumb")
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
