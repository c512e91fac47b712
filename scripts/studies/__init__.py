"""Experiments of the thesis and further ones, one folder a topic."""
