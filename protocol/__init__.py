"""The shared vocabulary: what stations, coordinator, emulator and people say to each other.

Models here are frozen and versioned; one vocabulary serves wire and journal.
Only `protocol/adapters/` may touch zenoh or mcap; everything else is pure.
"""
