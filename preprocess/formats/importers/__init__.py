"""Readers of foreign tracking formats; every file here is one format and registers itself by its name."""
