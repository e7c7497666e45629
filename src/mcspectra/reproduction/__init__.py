"""Reproduction of the slides: one exhibit per module, with figures and claims with verdicts."""
