"""The public functions of `import ggavatar` that make and check captures (docs/api.md); found by entry points."""
