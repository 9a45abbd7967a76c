"""What the generated person looks like."""
