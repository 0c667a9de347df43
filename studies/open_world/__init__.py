"""The open world: physics that no library holds, drawn at random, and a second session that a law has to predict.

    python -m studies.open_world.draw  [--seed HASH] [--out FOLDER]     cases and, apart from them, their sealed answers
    python -m studies.open_world.score [--seed HASH] [--out FOLDER]     `highside diagnose` and `predict` on each case
    python -m studies.open_world.table [--seed HASH] [--out FOLDER]     every bar with its figure and interval
    python -m studies.open_world.given --seed SEED                      what closes with the true places given
    python -m studies.open_world.limit --seed HASH                      what theory allows to close and to tell
    python -m studies.open_world.check [MANIFEST]                       nobody has changed a case or an answer

`world` is the physics (gravity turned by Euler angles, the sensor's equations), `designs` the sessions, `noises` the
noise, `shapes` and `laws` what is hidden; `deck` draws cases, `section_one` makes the failures again from their
description, `by_hand` sessions of which |g| alone is known, `beside_simulation` pairs of a recording and a prediction,
`real` puts laws into open recordings. `judging` says what of an answer is right, `rivals` what well-kept regressions
reach on the same pairs of sessions, `whitening` what the noise lets be known of a signal, for `limit`. Nothing but the
scoring imports highside.
"""
