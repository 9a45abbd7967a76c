"""Evaluation protocols, their results, and statistics over them."""
