"""The CSLC beside other networks, outside the range of the training motion."""
