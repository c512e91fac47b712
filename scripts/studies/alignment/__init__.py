"""How often the torque that belongs to a sample is recognised."""
