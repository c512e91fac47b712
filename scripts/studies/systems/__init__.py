"""Identification of systems that are not manipulators: worked examples with their truth."""
