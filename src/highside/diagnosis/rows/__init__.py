"""Recordings looked at row by row: columns, inner products and coloured noise that rotation and simulation share."""
