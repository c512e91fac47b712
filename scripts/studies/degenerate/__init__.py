"""Recordings that determine little: what fits of them predict for other motion."""
