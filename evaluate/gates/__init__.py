"""Checks that fail a build: limits and regressions."""
