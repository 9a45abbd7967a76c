"""The live viewer: a run, a capture or a file of Gaussians in a browser, drawn by our rasterizers."""
