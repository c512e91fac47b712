"""PERAL on several classes of network, and when to switch to it (thesis 8.2.2)."""
