"""Diagnosis of captures: what is wrong, in words, and which flag fixes it."""
