"""The agent of one station: takes leases, runs them, and lets no result get lost.

`core.py`, `state.py`, `fences.py`, `events.py` are pure: events in, commands out. `shell.py` owns the
threads, the spool and the link; it may not know what a step does.
"""
