"""From a table of named columns to a proposal, and from a proposal to a Recording. Pure: no file, no clock.

source     what a form of file gives: named columns, and what was noticed while reading
policy     the numbers that decide
units      names of units and their factors
words      what the name of a column says: quantity, axis, unit
instants   dates and times of day written as text
timing     which column is the time, in which unit; wraps, resets, gaps, order
vectors    units of accelerations and rates by their values
columns    single columns: by the name given, by their range
axes       the maker's axes against a reference
wishes     what the user says, which goes before everything
proposal   the whole of it, as a table with evidence
recording  a proposal made a Recording, rows counted
"""

from __future__ import annotations

__all__ = ["policy", "proposal", "recording", "source", "wishes"]
"""the ways in: modules, loaded on request"""
