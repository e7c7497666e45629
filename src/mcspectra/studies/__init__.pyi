from .config import StudyConfig as StudyConfig
from .config import read_study as read_study
from .plan import make_plan as make_plan
from .run import run_study as run_study
from .store import Store as Store
from .store import open_results as open_results
from .summary import SummaryRow as SummaryRow
from .summary import summarize as summarize

__all__ = [
    "Store",
    "StudyConfig",
    "SummaryRow",
    "make_plan",
    "open_results",
    "read_study",
    "run_study",
    "summarize",
]
