"""Files of pretrained models: what they are, where they are looked for, how they are verified and downloaded."""
