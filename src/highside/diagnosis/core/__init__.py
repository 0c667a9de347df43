"""What every kind of recording shares: candidates, fits, tests, choice, rivals, memory, and the form of the answer."""
