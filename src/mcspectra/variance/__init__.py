"""Variance."""
