"""The pure core: `CoordinatorCore.handle(event) -> commands`.

No clock, no IO, no randomness: time comes in events, waiting is a SetTimer, numbers come from
counters in the state. See transitions.py for the theory.
"""
