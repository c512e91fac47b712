"""Smoothing methods beside the simulator's true velocities and accelerations."""
