"""Payloads learnt while they are carried."""
