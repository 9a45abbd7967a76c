"""The rasterizer for CUDA in Triton: no compiler at the user, no wait for the device; runs interpreted on a CPU."""
