"""Captures as training data: folders, schema, splits, frames, the scene a method sees."""
