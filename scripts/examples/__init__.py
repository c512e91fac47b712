"""Identification of real robots."""
