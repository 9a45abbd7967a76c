"""Files of pretrained models: where they are looked for, what they must be, how they are fetched."""
