"""Image, face and temporal metrics, and what an avatar costs."""
