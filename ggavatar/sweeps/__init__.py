"""Grids of trainings: cells, where they run, how long."""
