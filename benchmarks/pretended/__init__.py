"""A pretended CUDA device, on which every method can be run and its launches and synchronizations counted."""
