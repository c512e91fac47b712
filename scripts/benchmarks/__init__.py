"""Time and memory of both packages, compared with a committed baseline."""
