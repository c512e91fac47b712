"""The guard against injected faults."""
