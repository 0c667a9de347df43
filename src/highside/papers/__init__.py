"""The three papers reproduced: their tables beside ours, and the motions and instruments that this takes.

A leaf on top: the commands use it, and nothing else does.
"""
