"""Spectra of point sets: transforms, expected power, closed forms, pair correlation."""
