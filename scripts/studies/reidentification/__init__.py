"""Friction re-identified after bearings are cleaned."""
