"""The explorer, a page of bokeh's server; all modules but `mcspectra.app.specs` need the extra ``report``."""
