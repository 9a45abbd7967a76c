"""What training minimizes: image terms, regularizers, perceptual loss; each kernel beside its torch twin."""
