"""Diagnosis: where a recording departs from the simulation, what physics was left out, and how sure that is.

The way of a recording: `intake` (is the data what it claims to be?), `session` (rows to poses), `candidates` (what each
effect of the library, and what unnamed interactions, would add), `noise` (how large a departure chance makes),
`selection` (which candidates the data ask for), `location`, `rivals` (what cannot be told apart, what was not
testable), `engine` (all of it, to a verdict), `result` (the answer).
"""
