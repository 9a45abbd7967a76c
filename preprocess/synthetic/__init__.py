"""The generated person: a procedural head with hair and clothes, rendered to video, mattes, tracking and head model."""
