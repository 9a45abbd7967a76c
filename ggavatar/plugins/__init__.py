"""What other packages register under our entry-point groups (docs/plugins.md)."""
