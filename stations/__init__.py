"""The station agent: sequences, steps, drivers and the spool of one bench.

`sequencing/` is the pure core; agent, drivers and spool are its shell.
May import `calibration` and `protocol`; never the emulator: a bench is reached over its links only.
"""
