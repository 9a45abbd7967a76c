"""Head poses from several cues."""
