"""Drawing trained avatars into folders and videos."""
