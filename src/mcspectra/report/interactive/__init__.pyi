from .bands import band_plot as band_plot
from .bars import terms_plot as terms_plot
from .curves import convergence_plot as convergence_plot
from .curves import radial_plot as radial_plot
from .frame import alt_text as alt_text
from .maps import contribution_plot as contribution_plot
from .maps import spectrum_plot as spectrum_plot
from .points import points_plot as points_plot

__all__ = [
    "alt_text",
    "band_plot",
    "contribution_plot",
    "convergence_plot",
    "points_plot",
    "radial_plot",
    "spectrum_plot",
    "terms_plot",
]
