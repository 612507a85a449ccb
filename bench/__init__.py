"""Benchmarks of ssm_service, run from a checkout as ``python -m bench.NAME``."""
