"""The public functions of `import ggavatar` that measure (docs/api.md); found by their entry points."""
