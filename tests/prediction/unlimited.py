"""`mcspectra.predict` with as many evaluations of a function as the methods take."""

from functools import partial

import mcspectra as mcs

predict = partial(mcs.predict, max_evaluations=2**40)
