"""The embedded subject: a procedurally generated person with a video, tracking, mattes and a head model."""
