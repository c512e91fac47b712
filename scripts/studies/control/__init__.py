"""Computed torque with identified coefficients."""
