"""Foundations: errors, checks, random streams, spec strings, registries and point-set files."""
