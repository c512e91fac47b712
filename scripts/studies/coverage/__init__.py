"""How often confidence intervals hold the true coefficients."""
