"""Rates of other libraries that are measured by programs in their own language."""
