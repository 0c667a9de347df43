"""Calibration methods, records, and the correction that the live service applies."""
