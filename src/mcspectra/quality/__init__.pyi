from .figures import FIGURES as FIGURES
from .figures import FigureSummary as FigureSummary
from .figures import quality_figures as quality_figures
from .figures import summarize as summarize
from .sets import best_minimum_distance as best_minimum_distance
from .sets import diaphony as diaphony
from .sets import generalized_l2_discrepancy as generalized_l2_discrepancy
from .sets import l2_discrepancy as l2_discrepancy
from .sets import nearest_distances as nearest_distances
from .sets import relative_minimum_distance as relative_minimum_distance
from .sets import star_discrepancy as star_discrepancy
from .warps import warp_quality as warp_quality

__all__ = [
    "FIGURES",
    "FigureSummary",
    "best_minimum_distance",
    "diaphony",
    "generalized_l2_discrepancy",
    "l2_discrepancy",
    "nearest_distances",
    "quality_figures",
    "relative_minimum_distance",
    "star_discrepancy",
    "summarize",
    "warp_quality",
]
