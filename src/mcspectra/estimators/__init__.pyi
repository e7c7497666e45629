from .base import AbstractEstimator as AbstractEstimator
from .importance import Estimator as Estimator
from .importance import as_estimator as as_estimator
from .mis import MultipleImportance as MultipleImportance
from .mis import TechniqueSum as TechniqueSum
from .moments import Moments as Moments

__all__ = [
    "AbstractEstimator",
    "Estimator",
    "Moments",
    "MultipleImportance",
    "TechniqueSum",
    "as_estimator",
]
