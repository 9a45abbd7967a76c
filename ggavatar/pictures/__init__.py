"""What the stored pixels of pictures and video frames mean: orientation, transfer curves, gamuts, color profiles."""
