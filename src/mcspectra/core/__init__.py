"""Foundations: errors, checks, random streams, spec strings, registries, point-set files."""
