"""Measurements beside the peers and the machine's limits; each is ``python -m benchmarks.NAME``."""
