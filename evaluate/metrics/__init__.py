"""Measures of images and sequences, each a pure function."""
