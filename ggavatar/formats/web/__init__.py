"""The web avatar: one HTML file that shows and drives a trained avatar without network or server (docs/web-avatar.md)."""
