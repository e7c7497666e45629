"""One call for what is wrong with an estimator, why, and what to do: `profile.py` tells how."""
