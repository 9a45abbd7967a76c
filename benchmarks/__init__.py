"""Measurements of the compiled kernels: `python -m benchmarks rasterizer|step|scaling --json OUT`."""
