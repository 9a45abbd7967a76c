"""How the names of images end that count as frames in a folder."""

from __future__ import annotations

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
"""In small letters."""
