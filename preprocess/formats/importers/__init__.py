"""Importers of other trackers' formats; every module here is one format, registered under its name."""
