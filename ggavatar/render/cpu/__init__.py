"""The CPU rasterizer that we train with, as compiled kernels."""
