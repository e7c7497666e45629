"""The picture of the slides' exhibits, until these are plots."""

from mcspectra.report.picture import Picture

__all__ = ["Picture"]
