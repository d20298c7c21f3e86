"""Recordings of emulated units on emulated stands: who is recorded where, in chunks, into any writer.

Joins products, stands and profiles by their catalogues; knows none of them itself.
May import `protocol` and the rest of `dut_emulator` but its server.
"""
