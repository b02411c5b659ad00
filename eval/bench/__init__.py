"""Benchmarks of controller, learning and data, beside rival references."""
