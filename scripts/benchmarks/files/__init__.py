"""Fits to Parquet files: one longer than memory, and many on a cluster."""
