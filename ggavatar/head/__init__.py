"""Linear-blend-skinned heads: one model whose arrays come from a file, a generator or a tracker."""
