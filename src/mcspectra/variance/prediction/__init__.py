"""Variances predicted from what is known of an integrand and of a sampler, and their rates."""
