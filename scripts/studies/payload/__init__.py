"""Payloads identified while they are carried."""
