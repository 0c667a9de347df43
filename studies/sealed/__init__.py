"""The sealed decks of `highside diagnose`: cases that did not exist before the engine was frozen, and their truth.

`python -m studies.sealed.score` runs them. `world` makes them and shares no code with highside; `deck` and `real_noise`
say what is in them; `judging` and `table` what of the answers is right; `baselines` what sparse regressions answer.
"""
