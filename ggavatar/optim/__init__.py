"""Optimization: row-aligned parameters, learning-rate schedules, seeded generators, corrections of the tracking."""
