from .base import AbstractEstimator as AbstractEstimator
from .channels import ChannelSampling as ChannelSampling
from .channels import channel_estimators as channel_estimators
from .heuristics import HEURISTICS as HEURISTICS
from .heuristics import Combination as Combination
from .heuristics import Heuristic as Heuristic
from .heuristics import as_heuristic as as_heuristic
from .importance import Estimator as Estimator
from .importance import as_estimator as as_estimator
from .importance import as_subject as as_subject
from .mirrored import MIRRORINGS as MIRRORINGS
from .mirrored import Mirrored as Mirrored
from .mis import MultipleImportance as MultipleImportance
from .mis import TechniqueSum as TechniqueSum
from .moments import Moments as Moments
from .one_sample import OneSampleMIS as OneSampleMIS
from .split import split_mixture as split_mixture
from .vegas_ import VegasDensity as VegasDensity

__all__ = [
    "HEURISTICS",
    "MIRRORINGS",
    "AbstractEstimator",
    "ChannelSampling",
    "Combination",
    "Estimator",
    "Heuristic",
    "Mirrored",
    "Moments",
    "MultipleImportance",
    "OneSampleMIS",
    "TechniqueSum",
    "VegasDensity",
    "as_estimator",
    "as_heuristic",
    "as_subject",
    "channel_estimators",
    "split_mixture",
]
