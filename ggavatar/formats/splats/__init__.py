"""Gaussians as the files of splats store them: kinds by content, readers, writers, and what is sound in them."""
