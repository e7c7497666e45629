"""Reproduction of the slides: one exhibit per module, with figures, claims and their verdicts."""
