"""Units under test, stands, instruments and their faults, emulated from physics, on real links.

The physics and the firmware are pure; `server/` is the shell that offers them over TCP and ptys.
May import `protocol` only.
"""
