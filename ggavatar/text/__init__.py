"""Text from elsewhere: what a name is, and how any text is shown on a terminal."""
