from .estimate import CellEstimate as CellEstimate
from .estimate import estimate_study as estimate_study
from .files import StudyConfig as StudyConfig
from .files import decode_study as decode_study
from .files import read_study as read_study
from .files import study_file as study_file
from .path import analyse_path as analyse_path
from .pixel import analyse_pixel as analyse_pixel
from .plan import make_plan as make_plan
from .results import StudyStatus as StudyStatus
from .results import export_results as export_results
from .results import open_results as open_results
from .results import result_paths as result_paths
from .results import result_scalars as result_scalars
from .results import study_status as study_status
from .run import run_study as run_study
from .schema import study_schema as study_schema
from .summary import SummaryRow as SummaryRow
from .summary import summarize as summarize
from .vetting import Trust as Trust

__all__ = [
    "CellEstimate",
    "StudyConfig",
    "StudyStatus",
    "SummaryRow",
    "Trust",
    "analyse_path",
    "analyse_pixel",
    "decode_study",
    "estimate_study",
    "export_results",
    "make_plan",
    "open_results",
    "read_study",
    "result_paths",
    "result_scalars",
    "run_study",
    "study_file",
    "study_schema",
    "study_status",
    "summarize",
]
