"""Files in and out: arrays, images, JSON, pickles of others; bounded, checked, atomic."""
