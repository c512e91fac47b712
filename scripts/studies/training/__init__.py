"""Training of adaptive networks: the CSLC, PERAL, figures of Chapter 3."""
