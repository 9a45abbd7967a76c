"""Foreground masks: networks, GrabCut, masks made elsewhere."""
