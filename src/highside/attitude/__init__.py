"""Inclination, toolface and azimuth from vectors: single frames (`scalar`), blocks (`block`), covariance propagation.

Radians inside; arrays are `(3, N)`. Knows numpy and nothing else.
"""
