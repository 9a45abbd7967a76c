"""The compiled CPU rasterizer."""
