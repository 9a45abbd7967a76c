"""Face detection, 478 face landmarks and 52 blendshape scores, by MediaPipe's networks run in OpenCV."""
