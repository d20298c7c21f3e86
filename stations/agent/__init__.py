"""The agent of one station: takes leases, runs them, and lets no result get lost.

`core.py`, `state.py`, `fences.py` and `events.py` are pure: events in, commands out. `shell.py` owns the threads, the spool and the link;
`caller.py` asks the coordinator, `bench_watch.py` reads what the bench is, `records.py` makes records.
"""
