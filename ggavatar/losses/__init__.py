"""Losses: image terms, regularizers and the perceptual loss; compiled kernels are beside their torch twins."""
