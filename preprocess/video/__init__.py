"""Frames from videos and image folders: decoding, selection, cropping."""
