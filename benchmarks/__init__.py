"""Benchmarks: run time against error, see `__main__`."""
