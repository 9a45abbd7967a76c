"""Scoring: from runs and folders of images to evaluations."""
