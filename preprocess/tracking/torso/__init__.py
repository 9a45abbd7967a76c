"""The torso, followed beside the head."""
