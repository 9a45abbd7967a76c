"""What this package adds to GGAvatar; pyproject.toml says under which names."""
