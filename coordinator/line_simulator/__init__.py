"""A seeded line in one thread: the real core, model stations, and a network that loses and delays.

`python -m coordinator.line_simulator --seed 7` runs one line through faults and checks it after
every event; `--capacity` runs one without faults and says what it can do. See __main__.py.
"""
