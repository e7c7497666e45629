from .compare import write_comparison as write_comparison
from .sentences import explain as explain
from .study import write_report as write_report
from .tables import summary_table as summary_table
from .tables import terms_table as terms_table

__all__ = [
    "explain",
    "summary_table",
    "terms_table",
    "write_comparison",
    "write_report",
]
