"""Fields over space, perceptrons and the Geometry Morph Adjuster."""
