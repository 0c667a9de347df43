"""Research programs: what the figures of `docs/evidence.md` come from, and the decks that the engine is judged by.

No part of the product and no test: each is run from the top of the checkout, `python -m studies.NAME`, and prints its
tables. They run for minutes to hours. Tests take their simulated sensors and cases from here, and run some of them
short. Speeds are measured elsewhere (`tests/bench`, `make bench`).

Where a study has the options `--workers` and `--parts`, its cases are answered by the processes of a fleet
(`studies.over_seeds`): the same figures, on all processors, and a study that was interrupted goes on where it stopped.

| program | asks |
|---|---|
| `calibration_montecarlo` | how near each calibration method comes to the least error that is possible |
| `schedule_coverage`, `session_coverage` | whether stated uncertainties of corrections and of bench sessions hold |
| `structure_montecarlo`, `rolling_bias_limits` | what structure between zones costs, what an in-run one can know |
| `balance_coverage` | whether what one published table predicts of the others holds |
| `drift_scenarios`, `drift_limit`, `drift_real` | azimuth: methods, the least drift possible, real recordings |
| `watch_wells`, `survey_analysis` | the watch and the analysis of surveys over simulated wells |
| `watch_limits` | sizes of departures that the watch finds, against the Cramer-Rao bound |
| `watch_noise` | what the watch says where the noise of a sensor changes and nothing else |
| `watch_real` | false alarms of the watch over open recordings |
| `rotation_gap` | compensation over a part of the turn that was never seen |
| `diagnosis_deck` (`rotation_deck`, `rotation_cases`) | the development deck of `highside diagnose` |
| `fleet_lots`, `fleet_scale` | what lots of tools share, and what distributing costs |
| `giant_recording` | cost and memory of one long recording |
| `sealed.score` | the sealed decks of `highside diagnose` |
"""
