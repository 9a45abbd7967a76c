"""Readers and writers of other trackers' files, converted to our conventions."""
