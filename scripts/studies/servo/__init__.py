"""Arms of position servos, simulated in MuJoCo by equations of their own, and identified."""
