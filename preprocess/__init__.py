"""From a portrait video to a capture folder: frames, crop, masks, tracking, checks."""
