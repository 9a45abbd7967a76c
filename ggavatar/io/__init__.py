"""File input and output: arrays, images, JSON, foreign pickles; of bounded size, checked, written atomically."""
