"""Calibration records: coefficients that keep their unit, uncertainty, origin and validity with them.

Pure: made from results and facts that are handed in, compared, applied, followed over a unit's life.
The command line reads and writes the files.
"""
