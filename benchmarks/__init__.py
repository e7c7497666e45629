"""Benchmarks relative to a reference in the same run: ``python -m benchmarks [name]``."""
