"""Modules that most tasks need. They are loaded once, by the process that forks the workers.

Otherwise each worker spends more time on imports than on its first tasks.
"""

import scipy.special
import xarray

from mcspectra.core.streams import Stream
from mcspectra.densities import tabulated
from mcspectra.measure import converge, terms
from mcspectra.prediction import prediction
from mcspectra.samplers import scrambles, stratified
from mcspectra.spectra import transforms
from mcspectra.studies import plan

__all__ = ["converge", "plan", "prediction", "scipy", "scrambles", "stratified", "tabulated"]
__all__ += ["terms", "transforms", "xarray"]

# The first call of a compiled function loads the rest of Numba
Stream.from_rng(0).child(0)
