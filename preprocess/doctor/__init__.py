"""What is wrong with a capture, in words, and which flag mends it."""
