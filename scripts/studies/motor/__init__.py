"""The linearity of motors."""
