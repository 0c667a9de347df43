"""Is the recording what it claims to be? Faults of the data that no physics explains."""
