"""The person's own head: from a generic one to the tracked shape."""
