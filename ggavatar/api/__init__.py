"""The public functions of `import ggavatar` that need neither `preprocess` nor `evaluate` (docs/api.md)."""
