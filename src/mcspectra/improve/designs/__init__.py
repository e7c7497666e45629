"""Samplers designed for a class of integrands: objectives, searches and certificates."""
