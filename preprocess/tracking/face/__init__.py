"""Expressions, gaze and the shape of the face."""
