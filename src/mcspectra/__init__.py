"""mcspectra."""
