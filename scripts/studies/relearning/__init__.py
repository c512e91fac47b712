"""Friction re-identified after it has fallen."""
