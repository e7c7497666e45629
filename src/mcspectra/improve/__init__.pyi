from .alignment import aligned as aligned
from .alignment import best_alignment as best_alignment
from .alignment import strata_shift_scan as strata_shift_scan
from .answers import Answer as Answer
from .answers import Candidate as Candidate
from .answers import CandidateResult as CandidateResult
from .designs.design import certificate as certificate
from .designs.design import design as design
from .learned import learned_density as learned_density
from .planning import plan as plan
from .remedy import remedies as remedies
from .variants import mirror_study as mirror_study
from .variants import smoothing_scan as smoothing_scan

__all__ = [
    "Answer",
    "Candidate",
    "CandidateResult",
    "aligned",
    "best_alignment",
    "certificate",
    "design",
    "learned_density",
    "mirror_study",
    "plan",
    "remedies",
    "smoothing_scan",
    "strata_shift_scan",
]
