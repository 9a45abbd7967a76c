"""Figures of results: comparisons, error maps, curves, videos, the report."""
