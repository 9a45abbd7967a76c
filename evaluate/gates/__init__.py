"""Gates for continuous integration: limits and regressions."""
