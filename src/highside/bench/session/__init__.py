"""The bench calibration state machine and its journal: events in, state and prompts out; the clock is injected."""
