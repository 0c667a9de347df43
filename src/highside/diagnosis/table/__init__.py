"""Published error tables: means and peak-to-peaks after a correction, to a verdict."""
