"""The figures and statements of the slides, made again: one exhibit a module, claims with verdicts."""
