"""Captures as training data: the folder and its schema, splits, frames, and the scene that methods receive."""
