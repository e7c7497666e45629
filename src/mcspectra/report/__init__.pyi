from . import figures as figures
from .compare import write_comparison as write_comparison
from .html import write_report as write_report
from .reproduction.run import reproduce as reproduce
from .sentences import explain as explain
from .style import LineStyle as LineStyle
from .style import sampler_styles as sampler_styles
from .tables import summary_table as summary_table
from .tables import terms_table as terms_table

__all__ = [
    "LineStyle",
    "explain",
    "figures",
    "reproduce",
    "sampler_styles",
    "summary_table",
    "terms_table",
    "write_comparison",
    "write_report",
]
