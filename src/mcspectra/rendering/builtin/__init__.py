"""Scenes that come with the package: a module each, found through `mcspectra.rendering.SCENES`."""

__all__: list[str] = []
