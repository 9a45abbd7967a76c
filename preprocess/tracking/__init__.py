"""Our own tracker: from landmarks, outlines and texture to a head, its poses and its expressions."""
