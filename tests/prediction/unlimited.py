"""`mcspectra.predict` without a limit on evaluations of a function."""

from functools import partial

import mcspectra as mcs

predict = partial(mcs.predict, max_evaluations=2**40)
