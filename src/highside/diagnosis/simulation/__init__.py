"""Recordings beside another program's prediction of them."""
