"""Recordings that other programs wrote, read as ours: columns, units, time and axes, each with the evidence for it.

A foreign file says what its columns are in its own words, or not at all. What it does not say is inferred from names,
units and values; every inference carries its evidence and how certain it is, is shown before it is used, and can be
overridden. What cannot be decided is refused in one line that names the option which decides it. No cell that is a text
is ever made a number, no row is dropped without being counted.

    core       pure: a table of named columns in, a proposal with its evidence and then a Recording out
    forms      one file a form of file: bytes in, tables of named columns out; `forms.registry` knows them all
    profiles   mappings kept by name in the user's folder of settings
    joins      tables joined to it: references, other topics of the same container
    files      the way in: a file, and what the user says of it, to a proposal and a Recording
"""

from __future__ import annotations

__all__ = ["core", "files", "forms", "joins", "profiles"]
"""the ways in: modules, loaded on request"""
