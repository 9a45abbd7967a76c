"""Other trackers' output, read into our conventions."""
