"""Animation of the generated person: performance, posing, hair motion."""
