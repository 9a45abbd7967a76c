"""GGAvatar: an animatable 3D-Gaussian head avatar from a portrait video (Li et al., Pacific Graphics 2024)."""
