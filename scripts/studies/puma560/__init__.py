"""The experiment of Chapter 7: `make demo`."""
