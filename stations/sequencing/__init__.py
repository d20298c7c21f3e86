"""Sequences: a pure core that decides (`core.py`), and the shell that runs its steps on a bench.

The core may import no clock, thread or socket. Step functions see a `StepContext` and nothing else.
"""
