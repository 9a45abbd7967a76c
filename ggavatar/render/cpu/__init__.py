"""The CPU rasteriser that we train with, as compiled kernels."""
