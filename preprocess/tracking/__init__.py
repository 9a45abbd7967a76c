"""The built-in tracker: from landmarks, outlines and texture to a head model, its poses and its expressions."""
