"""What training minimises: image terms, regularisers, perceptual loss; each kernel beside its torch twin."""
