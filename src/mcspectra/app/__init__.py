"""The explorer: a page on bokeh's server. All modules except `specs` need the extra ``report``."""
