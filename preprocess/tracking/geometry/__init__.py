"""Projection, rigid motion, smoothing and the landmark model."""
