"""Faces in pictures: where they are, 478 landmarks and 52 blendshape scores. Networks of one file, run by OpenCV."""
