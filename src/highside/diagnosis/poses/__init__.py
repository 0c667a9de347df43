"""Stepped sessions with a known reference: one mean a stop."""
