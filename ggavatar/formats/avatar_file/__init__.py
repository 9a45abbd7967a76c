"""The avatar file: an avatar without its run and its capture, in one file (docs/avatar-file.md)."""
