"""Foreground masks: matting networks, GrabCut, and pairing of the user's masks."""
