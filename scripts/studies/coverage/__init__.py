"""How often confidence intervals cover the true coefficients."""
