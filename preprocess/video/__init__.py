"""Frames out of videos and folders of images: decoding, selection, crop."""
