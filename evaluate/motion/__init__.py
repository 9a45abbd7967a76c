"""What an avatar is made to do: orbits, and the performance of somebody else."""
