"""Figures with their goals, each beside a peer that is measured in the same run.

`python -m benchmarks` runs them all; `python -m benchmarks NAME …` some.
"""
