"""Feature fields over space, multilayer perceptrons and the Geometry Morph Adjuster."""
