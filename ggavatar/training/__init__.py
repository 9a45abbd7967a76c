"""From a capture and a method to a run folder: plan, trainer, checkpoints, provenance."""
