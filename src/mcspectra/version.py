"""The version of this package, as its installation says."""

from importlib.metadata import version

__all__ = ["__version__"]

__version__ = version("mcspectra")
