"""The web avatar: one HTML file that shows and drives an avatar without network or server (docs/web-avatar.md)."""
