"""Projection, rigid poses, smoothing and the landmark model."""
