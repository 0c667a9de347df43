"""Rotating recordings with a known reference: single rows."""
