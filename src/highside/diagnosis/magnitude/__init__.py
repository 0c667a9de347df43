"""Sessions of unknown attitude, of which only the magnitude of gravity is known."""
