"""Photometric refinement of a tracking: a short avatar draws the frames, and the tracking follows its gradients."""
