"""Rendering of trained avatars to folders and videos."""
