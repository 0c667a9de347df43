"""The forward model: gravity in the tool frame, the bench, the sensors, motion, noise; one library of effects.

Simulation, calibration and diagnosis use the same objects from here.
"""
