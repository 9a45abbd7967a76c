"""Evaluation protocols, evaluation results, and statistics over them."""
