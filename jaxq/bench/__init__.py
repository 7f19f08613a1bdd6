"""Measuring throughput: our own suites, and the contest that they and the peers of ``benchmarks/`` run in."""
