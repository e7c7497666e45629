from .maps import band_covariances as band_covariances
from .maps import contributions as contributions
from .maps import cross_matrices as cross_matrices
from .pairs import pair_correlations as pair_correlations
from .pixel import remedy_ratios as remedy_ratios
from .points import point_sets as point_sets
from .scene_maps import map_figures as map_figures
from .spectra import power_images as power_images
from .spectra import power_lines as power_lines
from .spectra import radial_power as radial_power
from .strategy_images import strategy_images as strategy_images
from .variance import captured_curves as captured_curves
from .variance import convergence_curves as convergence_curves
from .variance import three_terms as three_terms
from .warps import primary_pictures as primary_pictures
from .warps import warp_maps as warp_maps

__all__ = [
    "band_covariances",
    "captured_curves",
    "contributions",
    "convergence_curves",
    "cross_matrices",
    "map_figures",
    "pair_correlations",
    "point_sets",
    "power_images",
    "power_lines",
    "primary_pictures",
    "radial_power",
    "remedy_ratios",
    "strategy_images",
    "three_terms",
    "warp_maps",
]
